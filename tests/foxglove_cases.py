"""Foxglove's messages, in protobuf and in JSON, written by hand."""

from __future__ import annotations

import json
import math
import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

SECOND = 1_000_000_000

Edge = tuple[str, str, tuple[float, float, float], tuple[float, float, float, float]]
Pose = tuple[float, float, float]


def field(number: int, wire: int, payload: bytes) -> bytes:
    return varint(number << 3 | wire) + payload


def varint(value: int) -> bytes:
    out = bytearray()
    while True:
        byte, value = value & 0x7F, value >> 7
        out.append(byte | (0x80 if value else 0))
        if not value:
            return bytes(out)


def nested(number: int, payload: bytes) -> bytes:
    return field(number, 2, varint(len(payload)) + payload)


def double(number: int, value: float) -> bytes:
    return field(number, 1, struct.pack("<d", value)) if value else b""


def _stamp(stamp_ns: int) -> bytes:
    seconds, nanoseconds = divmod(stamp_ns, SECOND)
    return field(1, 0, varint(seconds)) + field(2, 0, varint(nanoseconds))


def doubles(values: tuple[float, ...]) -> bytes:
    return b"".join(double(i + 1, value) for i, value in enumerate(values))


def _yaw(theta: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2)


def protobuf_scan(stamp_ns: int, ranges: Sequence[float], *, packed: bool = True) -> bytes:
    start = -0.5 * math.pi
    values = struct.pack(f"<{len(ranges)}d", *ranges)
    if packed:
        body = nested(6, values)
    else:
        body = b"".join(field(6, 1, values[i : i + 8]) for i in range(0, len(values), 8))
    return (
        nested(1, _stamp(stamp_ns))
        + nested(2, b"laser")
        + double(4, start)
        + double(5, start + (len(ranges) - 1) * math.pi / 180.0)
        + body
    )


def protobuf_transform(stamp_ns: int, edge: Edge) -> bytes:
    parent, child, translation, rotation = edge
    return (
        nested(1, _stamp(stamp_ns))
        + nested(2, parent.encode())
        + nested(3, child.encode())
        + nested(4, doubles(translation))
        + nested(5, doubles(rotation))
    )


def odometry_edge(pose: Pose) -> Edge:
    x, y, theta = pose
    return "odom", "base", (x, y, 0.0), _yaw(theta)


def protobuf_pose(stamp_ns: int, pose: Pose) -> bytes:
    x, y, theta = pose
    place = nested(1, doubles((x, y, 0.0))) + nested(2, doubles(_yaw(theta)))
    return nested(1, _stamp(stamp_ns)) + nested(2, b"odom") + nested(3, place)


def _json_stamp(stamp_ns: int) -> dict[str, int]:
    return {"sec": stamp_ns // SECOND, "nsec": stamp_ns % SECOND}


def _json_vector(values: tuple[float, ...]) -> dict[str, float]:
    return dict(zip("xyzw", values, strict=False))


def json_scan(stamp_ns: int, ranges: Sequence[float]) -> bytes:
    start = -0.5 * math.pi
    words = {math.inf: "Infinity"}
    values = [None if math.isnan(r) else words.get(r, r) for r in ranges]
    message = {
        "timestamp": _json_stamp(stamp_ns),
        "frame_id": "laser",
        "pose": {"position": _json_vector((0, 0, 0)), "orientation": _json_vector((0, 0, 0, 1))},
        "start_angle": start,
        "end_angle": start + (len(ranges) - 1) * math.pi / 180.0,
        "ranges": values,
        "intensities": [],
    }
    return json.dumps(message).encode()


def json_transform(stamp_ns: int, edge: Edge) -> bytes:
    parent, child, translation, rotation = edge
    message = {
        "timestamp": _json_stamp(stamp_ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": _json_vector(translation),
        "rotation": _json_vector(rotation),
    }
    return json.dumps(message).encode()


def json_pose(stamp_ns: int, pose: Pose) -> bytes:
    x, y, theta = pose
    message = {
        "timestamp": _json_stamp(stamp_ns),
        "frame_id": "odom",
        "pose": {
            "position": _json_vector((x, y, 0.0)),
            "orientation": _json_vector(_yaw(theta)),
        },
    }
    return json.dumps(message).encode()
