"""ROS 2 messages written as CDR, little endian: LaserScan, Odometry, TFMessage.

CDR aligns every number to its own size, counted from behind the four bytes of the
encapsulation header; strings are counted with their closing zero.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from hiermap_cli.logs.records import LaserGeometry, Transform

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_SECOND = 1_000_000_000
_SCAN_FIELDS = struct.Struct("<7f")
_POSE = struct.Struct("<7d")
_EPSILON = 2.0**-53  # relative; changes the last digit of a double by one at most
_VARIATIONS = [(i, k) for i in range(-6, 7) for k in range(-6, 7)]
_VARIATIONS.sort(key=lambda pair: abs(pair[0]) + abs(pair[1]))
_TWIST = bytes(8 * (6 + 36))


def stamp(stamp_ns: int) -> bytes:
    """`builtin_interfaces/Time`. Raises InputError beyond its range (the year 2038)."""
    seconds, nanoseconds = divmod(stamp_ns, _SECOND)
    try:
        return struct.pack("<iI", seconds, nanoseconds)
    except struct.error as error:
        raise InputError(f"stamp {stamp_ns} ns does not fit into a ROS header") from error


def text(value: str) -> bytes:
    """A string with its length."""
    data = value.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def aligned(data: bytes, size: int) -> bytes:
    """`data` (without encapsulation header) filled up to a multiple of `size`."""
    return data + bytes(-len(data) % size)


def laser_scan(stamp_ns: int, frame: str, ranges: ArrayLike, laser: LaserGeometry) -> bytes:
    """`sensor_msgs/msg/LaserScan`, without intensities."""
    values = np.asarray(ranges, dtype="<f4")
    head = aligned(stamp(stamp_ns) + text(frame), 4)
    last = laser.angle_min + laser.angle_increment * max(laser.beams - 1, 0)
    fields = _SCAN_FIELDS.pack(
        laser.angle_min,
        last,
        laser.angle_increment,
        0.0,
        0.0,
        laser.range_min,
        laser.range_max,
    )
    count = struct.pack("<I", len(values))
    return b"".join((_LITTLE_ENDIAN, head, fields, count, values.tobytes(), bytes(4)))


def odometry(
    stamp_ns: int,
    frame: str,
    child: str,
    pose: Sequence[float] | NDArray[np.float64],
    covariance: ArrayLike | None,
) -> bytes:
    """`nav_msgs/msg/Odometry` of a pose `[x, y, theta]` and its covariance (3, 3), no twist."""
    x, y, theta = (float(value) for value in pose)
    head = aligned(aligned(stamp(stamp_ns) + text(frame), 4) + text(child), 8)
    rotation = (0.0, 0.0, *planar_rotation(theta))
    full = np.zeros((6, 6), dtype="<f8")
    if covariance is not None:
        full[np.ix_((0, 1, 5), (0, 1, 5))] = covariance
    body = _POSE.pack(x, y, 0.0, *rotation)
    return b"".join((_LITTLE_ENDIAN, head, body, full.tobytes(), _TWIST))


def planar_rotation(theta: float) -> tuple[float, float]:
    """z and w of the quaternion of a heading, so that `2 atan2(z, w)` is the heading again.

    To the last bit: the last digits of sine and cosine are varied until it is. Whoever reads
    the log has the same odometry as whoever reads what it was converted from.
    """
    theta = math.remainder(theta, 2.0 * math.pi)
    z, w = math.sin(0.5 * theta), math.cos(0.5 * theta)
    if 2.0 * math.atan2(z, w) == theta:
        return z, w
    for i, k in _VARIATIONS:
        varied = z * (1.0 + i * _EPSILON), w * (1.0 + k * _EPSILON)
        if 2.0 * math.atan2(*varied) == theta:
            return varied
    return z, w


def tf_message(transforms: Sequence[Transform]) -> bytes:
    """`tf2_msgs/msg/TFMessage`."""
    data = struct.pack("<I", len(transforms))
    for edge in transforms:
        data = aligned(data, 4) + stamp(edge.stamp_ns) + text(edge.parent)
        data = aligned(aligned(data, 4) + text(edge.child), 8)
        data += _POSE.pack(*edge.translation, *edge.rotation)
    return _LITTLE_ENDIAN + data
