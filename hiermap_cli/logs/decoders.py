"""The messages that hiermap understands: (encoding, type) -> kind and decoder."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hiermap_cli.logs import foxglove, ros_decode
from hiermap_cli.logs import records as kinds
from hiermap_cli.logs.raw import RawScan
from hiermap_cli.logs.records import Odometry, Transform

Decoder = Callable[[bytes], Sequence[RawScan | Odometry | Transform]]

# What comes out of bytes that are no such message.
DECODE_ERRORS = (
    struct.error, ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError,
    RecursionError,
)  # fmt: skip


class Meaning(NamedTuple):
    """What the messages of a topic are, and how they are read."""

    kind: str
    decode: Decoder


_ROS: dict[str, tuple[str, Decoder, Decoder]] = {
    "sensor_msgs/LaserScan": (
        kinds.SCANS, ros_decode.laser_scan_cdr, ros_decode.laser_scan_ros1,
    ),
    "nav_msgs/Odometry": (
        kinds.ODOMETRY, ros_decode.odometry_cdr, ros_decode.odometry_ros1,
    ),
    "tf2_msgs/TFMessage": (
        kinds.TRANSFORMS, ros_decode.tf_message_cdr, ros_decode.tf_message_ros1,
    ),
    "tf/tfMessage": (
        kinds.TRANSFORMS, ros_decode.tf_message_cdr, ros_decode.tf_message_ros1,
    ),
}  # fmt: skip

_FOXGLOVE: dict[str, tuple[str, Decoder, Decoder]] = {
    "foxglove.LaserScan": (
        kinds.SCANS, foxglove.laser_scan_protobuf, foxglove.laser_scan_json,
    ),
    "foxglove.FrameTransform": (
        kinds.TRANSFORMS, foxglove.frame_transform_protobuf, foxglove.frame_transform_json,
    ),
    "foxglove.FrameTransforms": (
        kinds.TRANSFORMS, foxglove.frame_transforms_protobuf, foxglove.frame_transforms_json,
    ),
    "foxglove.PoseInFrame": (
        kinds.ODOMETRY, foxglove.pose_in_frame_protobuf, foxglove.pose_in_frame_json,
    ),
}  # fmt: skip


def _table() -> dict[tuple[str, str], Meaning]:
    table: dict[tuple[str, str], Meaning] = {}
    for name, (kind, cdr, ros1) in _ROS.items():
        table["cdr", name] = Meaning(kind, cdr)
        table["ros1", name] = Meaning(kind, ros1)
    for name, (kind, protobuf, from_json) in _FOXGLOVE.items():
        table["protobuf", name] = Meaning(kind, protobuf)
        table["json", name] = Meaning(kind, from_json)
    return table


MEANINGS = _table()


def meaning(topic: str, message_type: str, encoding: str) -> Meaning | None:
    """How messages of the type are read; None for types that are of no use here."""
    name = message_type.replace("/msg/", "/")
    found = MEANINGS.get((encoding.lower(), name))
    if found is not None and found.kind == kinds.TRANSFORMS and topic.endswith("static"):
        return found._replace(kind=kinds.STATIC_TRANSFORMS)
    return found
