"""LaserScan, Odometry and TFMessage out of ROS 2 CDR and ROS 1 bytes.

By hand, because these three are nearly all of a log and a general deserialiser takes six times
as long for a scan. Both serialisations have the same fields in the same order; they differ in
the header (ROS 1 has a sequence number), in the alignment of numbers (CDR aligns each to its
size, counted from behind the four bytes of the encapsulation header) and in CDR's zero byte at
the end of strings, which its count includes.

Every function raises `struct.error` or `ValueError` where the bytes are no such message.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from hiermap_cli.logs.raw import RawScan, stated
from hiermap_cli.logs.records import Odometry, Transform
from hiermap_cli.logs.transforms import planar_pose

_SECOND = 1_000_000_000
_MOST_TRANSFORMS = 1 << 20


class _Layout(NamedTuple):
    start: int  # of the message behind the encapsulation header
    sequence: bool  # headers have a sequence number
    align_long: int  # alignment of eight-byte numbers; 1 where nothing is aligned
    align: int
    zero: int  # bytes that end a string
    stamp: struct.Struct
    number: struct.Struct
    laser: struct.Struct
    pose: struct.Struct
    floats: np.dtype[np.float32]


def _layout(order: str, start: int, align: int, align_long: int, zero: int) -> _Layout:
    ros1 = start == 0
    return _Layout(
        start,
        ros1,
        align_long,
        align,
        zero,
        struct.Struct(order + ("III" if ros1 else "iI")),
        struct.Struct(order + "I"),
        struct.Struct(order + "7fI"),
        struct.Struct(order + "7d"),
        np.dtype(order + "f4"),
    )


_ROS1 = _layout("<", 0, 1, 1, 0)
# The encapsulation kinds: CDR big and little endian, and the second version of CDR, whose
# eight-byte numbers are aligned to four.
_CDR = {
    b"\x00\x00": _layout(">", 4, 4, 8, 1),
    b"\x00\x01": _layout("<", 4, 4, 8, 1),
    b"\x00\x06": _layout(">", 4, 4, 4, 1),
    b"\x00\x07": _layout("<", 4, 4, 4, 1),
}


def _cdr(data: bytes) -> _Layout:
    layout = _CDR.get(data[:2])
    if layout is None:
        raise ValueError(f"unknown encapsulation {data[:2].hex()}")
    return layout


def _header(data: bytes, layout: _Layout, at: int) -> tuple[int, str, int]:
    """Stamp (ns), frame and where the next field may begin."""
    seconds, nanoseconds = layout.stamp.unpack_from(data, at)[-2:]
    frame, at = _string(data, layout, at + layout.stamp.size)
    return seconds * _SECOND + nanoseconds, frame, at


def _string(data: bytes, layout: _Layout, at: int) -> tuple[str, int]:
    at = _aligned(at, layout.align)
    (length,) = layout.number.unpack_from(data, at)
    at += 4
    if at + length > len(data) or length < layout.zero:
        raise ValueError("string beyond the end of the message")
    return data[at : at + length - layout.zero].decode(), at + length


def _aligned(at: int, size: int) -> int:
    # The encapsulation header is four bytes long: what is aligned to eight behind it begins at
    # four more than a multiple of eight.
    if size == 8:
        return at + (4 - at) % 8
    return at + -at % size


def laser_scan_cdr(data: bytes) -> list[RawScan]:
    """`sensor_msgs/msg/LaserScan`."""
    return [_laser_scan(data, _cdr(data))]


def laser_scan_ros1(data: bytes) -> list[RawScan]:
    """`sensor_msgs/LaserScan`."""
    return [_laser_scan(data, _ROS1)]


def odometry_cdr(data: bytes) -> list[Odometry]:
    """`nav_msgs/msg/Odometry`."""
    return [_odometry(data, _cdr(data))]


def odometry_ros1(data: bytes) -> list[Odometry]:
    """`nav_msgs/Odometry`."""
    return [_odometry(data, _ROS1)]


def tf_message_cdr(data: bytes) -> list[Transform]:
    """`tf2_msgs/msg/TFMessage`."""
    return _tf_message(data, _cdr(data))


def tf_message_ros1(data: bytes) -> list[Transform]:
    """`tf2_msgs/TFMessage` and `tf/tfMessage`."""
    return _tf_message(data, _ROS1)


def _laser_scan(data: bytes, layout: _Layout) -> RawScan:
    stamp_ns, frame, at = _header(data, layout, layout.start)
    at = _aligned(at, layout.align)
    angle_min, _, increment, _, _, range_min, range_max, beams = layout.laser.unpack_from(data, at)
    # frombuffer itself refuses a count beyond the end of the message.
    ranges = np.frombuffer(data, layout.floats, beams, at + layout.laser.size)
    return RawScan(
        stamp_ns, frame, ranges, angle_min, increment, range_min, stated(range_min, range_max)
    )


def _odometry(data: bytes, layout: _Layout) -> Odometry:
    stamp_ns, frame, at = _header(data, layout, layout.start)
    child, at = _string(data, layout, at)
    x, y, z, *rotation = layout.pose.unpack_from(data, _aligned(at, layout.align_long))
    qx, qy, qz, qw = rotation
    x, y, theta = planar_pose((x, y, z), (qx, qy, qz, qw))
    return Odometry(stamp_ns, x, y, theta, frame, child)


def _tf_message(data: bytes, layout: _Layout) -> list[Transform]:
    (count,) = layout.number.unpack_from(data, layout.start)
    if count > _MOST_TRANSFORMS:
        raise ValueError(f"{count} transforms in one message")
    at = layout.start + 4
    edges = []
    for _ in range(count):
        stamp_ns, parent, at = _header(data, layout, _aligned(at, layout.align))
        child, at = _string(data, layout, at)
        at = _aligned(at, layout.align_long)
        x, y, z, qx, qy, qz, qw = layout.pose.unpack_from(data, at)
        at += layout.pose.size
        edges.append(Transform(stamp_ns, parent, child, (x, y, z), (qx, qy, qz, qw)))
    return edges
