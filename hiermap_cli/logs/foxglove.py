"""Foxglove's LaserScan, FrameTransform(s) and PoseInFrame, in protobuf and in JSON.

Protobuf is decoded from the wire by the field numbers of Foxglove's published schemas; those
numbers cannot change without breaking every reader. A scan's own `pose` in its frame becomes a
transform to a frame of its own. Every function raises ValueError, KeyError, TypeError or
struct.error where the bytes are no such message.
"""

from __future__ import annotations

import json
import struct
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from hiermap_cli.logs.raw import RawScan
from hiermap_cli.logs.records import Odometry, Transform
from hiermap_cli.logs.transforms import planar_pose

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Vector = tuple[float, float, float]
    Quaternion = tuple[float, float, float, float]
    Placement = tuple[Vector, Quaternion]

OWN_FRAME = "#scan"  # ends the name of the frame that a scan's own pose makes

_SECOND = 1_000_000_000
_DOUBLE = struct.Struct("<d")
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_NOWHERE: Placement = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Field numbers with their raw values: an int for varints, else bytes."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        if wire == _VARINT:
            value, at = _varint(data, at)
            yield number, value
            continue
        if wire == _BYTES:
            length, at = _varint(data, at)
        elif wire in (_FIXED64, _FIXED32):
            length = 8 if wire == _FIXED64 else 4
        else:
            raise ValueError(f"protobuf wire type {wire}")
        if at + length > len(data):
            raise ValueError("protobuf field beyond the end of the message")
        yield number, data[at : at + length]
        at += length


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        if at >= len(data) or shift > 63:
            raise ValueError("protobuf number without an end")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7


def _raw(value: int | bytes) -> bytes:
    if isinstance(value, int):
        raise TypeError("a number where protobuf should have bytes")
    return value


def _doubles(data: bytes, count: int) -> list[float]:
    """Fields 1 to `count` of a message of doubles; those left out are zero."""
    values = [0.0] * count
    for number, value in fields(data):
        if 1 <= number <= count:
            values[number - 1] = _DOUBLE.unpack(_raw(value))[0]
    return values


def _timestamp(data: bytes) -> int:
    seconds = nanoseconds = 0
    for number, value in fields(data):
        if isinstance(value, int):
            signed = value - (1 << 64) if value >= 1 << 63 else value
            seconds, nanoseconds = (signed, nanoseconds) if number == 1 else (seconds, signed)
    return seconds * _SECOND + nanoseconds


def _quaternion(data: bytes) -> Quaternion:
    x, y, z, w = _doubles(data, 4)
    return (x, y, z, w) if any((x, y, z, w)) else (0.0, 0.0, 0.0, 1.0)


def _vector(data: bytes) -> Vector:
    x, y, z = _doubles(data, 3)
    return x, y, z


def _pose(data: bytes) -> Placement:
    position, orientation = _NOWHERE
    for number, value in fields(data):
        if number == 1:
            position = _vector(_raw(value))
        elif number == 2:
            orientation = _quaternion(_raw(value))
    return position, orientation


def laser_scan_protobuf(data: bytes) -> list[RawScan | Transform]:
    """`foxglove.LaserScan`: timestamp 1, frame_id 2, pose 3, start 4, end 5, ranges 6."""
    stamp_ns, frame, place, start, end = 0, "", _NOWHERE, 0.0, 0.0
    parts: list[bytes] = []
    for number, value in fields(data):
        if number == 1:
            stamp_ns = _timestamp(_raw(value))
        elif number == 2:
            frame = _raw(value).decode()
        elif number == 3:
            place = _pose(_raw(value))
        elif number == 4:
            (start,) = _DOUBLE.unpack(_raw(value))
        elif number == 5:
            (end,) = _DOUBLE.unpack(_raw(value))
        elif number == 6:
            parts.append(_raw(value))
    ranges = np.frombuffer(b"".join(parts), dtype="<f8")
    return _scan(stamp_ns, frame, place, start, end, ranges)


def frame_transform_protobuf(data: bytes) -> list[Transform]:
    """`foxglove.FrameTransform`: timestamp 1, parent 2, child 3, translation 4, rotation 5."""
    stamp_ns, parent, child = 0, "", ""
    translation, rotation = _NOWHERE
    for number, value in fields(data):
        if number == 1:
            stamp_ns = _timestamp(_raw(value))
        elif number == 2:
            parent = _raw(value).decode()
        elif number == 3:
            child = _raw(value).decode()
        elif number == 4:
            translation = _vector(_raw(value))
        elif number == 5:
            rotation = _quaternion(_raw(value))
    return [Transform(stamp_ns, parent, child, translation, rotation)]


def frame_transforms_protobuf(data: bytes) -> list[Transform]:
    """`foxglove.FrameTransforms`: transforms 1."""
    return [
        edge
        for number, value in fields(data)
        if number == 1
        for edge in frame_transform_protobuf(_raw(value))
    ]


def pose_in_frame_protobuf(data: bytes) -> list[Odometry]:
    """`foxglove.PoseInFrame`: timestamp 1, frame_id 2, pose 3."""
    stamp_ns, frame, place = 0, "", _NOWHERE
    for number, value in fields(data):
        if number == 1:
            stamp_ns = _timestamp(_raw(value))
        elif number == 2:
            frame = _raw(value).decode()
        elif number == 3:
            place = _pose(_raw(value))
    return [Odometry(stamp_ns, *planar_pose(*place), frame=frame)]


def laser_scan_json(data: bytes) -> list[RawScan | Transform]:
    """`foxglove.LaserScan`; ranges that JSON cannot write are null or strings."""
    message = _object(data)
    ranges = np.array([_number(value) for value in message["ranges"]], dtype=np.float64)
    return _scan(
        _json_stamp(message["timestamp"]),
        str(message.get("frame_id", "")),
        _json_pose(message.get("pose")),
        float(message["start_angle"]),
        float(message["end_angle"]),
        ranges,
    )


def frame_transform_json(data: bytes) -> list[Transform]:
    """`foxglove.FrameTransform`."""
    return [_json_transform(_object(data))]


def frame_transforms_json(data: bytes) -> list[Transform]:
    """`foxglove.FrameTransforms`."""
    return [_json_transform(edge) for edge in _object(data)["transforms"]]


def pose_in_frame_json(data: bytes) -> list[Odometry]:
    """`foxglove.PoseInFrame`."""
    message = _object(data)
    pose = planar_pose(*_json_pose(message["pose"]))
    stamp_ns = _json_stamp(message["timestamp"])
    return [Odometry(stamp_ns, *pose, frame=str(message.get("frame_id", "")))]


def _scan(
    stamp_ns: int,
    frame: str,
    place: Placement,
    start: float,
    end: float,
    ranges: NDArray[np.float64],
) -> list[RawScan | Transform]:
    """The scan; before it the transform to its own frame where its pose is not the frame's."""
    increment = (end - start) / max(len(ranges) - 1, 1)
    out: list[RawScan | Transform] = []
    if place != _NOWHERE:
        out.append(Transform(stamp_ns, frame, frame + OWN_FRAME, *place))
        frame += OWN_FRAME
    with np.errstate(over="ignore"):
        values = ranges.astype(np.float32)
    out.append(RawScan(stamp_ns, frame, values, start, increment, 0.0, None))
    return out


def _object(data: bytes) -> dict[str, Any]:
    message = json.loads(data)
    if not isinstance(message, dict):
        raise TypeError("the JSON message is no object")
    return message


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _json_stamp(value: Any) -> int:
    """`{"sec", "nsec"}`, protobuf's own names, or an RFC 3339 string."""
    if isinstance(value, str):
        whole, _, rest = value.rstrip("Zz").partition(".")
        moment = datetime.fromisoformat(whole).replace(tzinfo=UTC)
        return int(moment.timestamp()) * _SECOND + int((rest or "0")[:9].ljust(9, "0"))
    seconds = value["sec"] if "sec" in value else value["seconds"]
    nanoseconds = next((value[k] for k in ("nsec", "nanosec", "nanos") if k in value), 0)
    return int(seconds) * _SECOND + int(nanoseconds)


def _json_vector(value: Any) -> Vector:
    value = value or {}
    return (
        float(value.get("x", 0.0)), float(value.get("y", 0.0)), float(value.get("z", 0.0)),
    )  # fmt: skip


def _json_pose(value: Any) -> Placement:
    value = value or {}
    return _json_vector(value.get("position")), _json_rotation(value.get("orientation"))


def _json_rotation(value: Any) -> Quaternion:
    x, y, z = _json_vector(value)
    w = float((value or {}).get("w", 0.0))
    return (x, y, z, w) if any((x, y, z, w)) else (0.0, 0.0, 0.0, 1.0)


def _json_transform(edge: dict[str, Any]) -> Transform:
    return Transform(
        _json_stamp(edge["timestamp"]),
        str(edge["parent_frame_id"]),
        str(edge["child_frame_id"]),
        _json_vector(edge.get("translation")),
        _json_rotation(edge.get("rotation")),
    )
