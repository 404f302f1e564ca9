"""The first part of a log, as far as it is needed to decide how the whole is read."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.logs import records as kinds
from hiermap_cli.logs.records import Odometry, Record, Scan, Transform
from hiermap_cli.logs.transforms import FrameTree, frame_name

if TYPE_CHECKING:
    from hiermap_cli.logs.choice import OdometryChoice
    from hiermap_cli.logs.source import Source

HEAD = 64  # scans, and odometry readings, that decide
ODOMETRY_FRAMES = ("odom", "odometry", "odom_combined")
TELLINGS = 64  # of one edge that are kept


class Head(NamedTuple):
    """The first records of the chosen topics; each list is bounded.

    scans, odometry: records of the chosen topics. moving: transforms of the transform topics.
    told: edges that come with the scans themselves (a CARMEN log's PARAM, the pose of a
    Foxglove scan in its frame).
    """

    scans: list[Record]
    odometry: list[Record]
    moving: list[Record]
    told: list[Transform]

    def scan_frame(self) -> str:
        """The frame of the scans, without a leading slash."""
        frames = (r.value.frame for r in self.scans if isinstance(r.value, Scan))
        return frame_name(next(frames, ""))


def read_head(source: Source, scan_topic: str, odometry: OdometryChoice) -> Head:
    """Reads until HEAD scans and HEAD odometry readings have been seen, or the log ends.

    Where odometry comes as transforms, those count whose parent is called as odometry's frame
    usually is, or that were asked for.
    """
    frames = frozenset(t.name for t in source.topics() if t.kind == kinds.TRANSFORMS)
    head = Head([], [], [], [])
    tellings: Counter[tuple[str, str]] = Counter()
    readings = 0
    for record in source.records(frozenset({scan_topic}) | odometry.topics | frames):
        value = record.value
        if isinstance(value, Scan):
            if record.topic == scan_topic and len(head.scans) < HEAD:
                head.scans.append(record)
        elif isinstance(value, Odometry):
            if record.topic in odometry.topics and len(head.odometry) < HEAD:
                head.odometry.append(record)
                readings += 1
        elif isinstance(value, Transform):
            edge = (frame_name(value.parent), frame_name(value.child))
            tellings[edge] += 1
            if tellings[edge] > TELLINGS:
                continue
            if record.topic == scan_topic:
                head.told.append(value)
            else:
                head.moving.append(record)
                readings += odometry.from_transforms and is_odometry_edge(edge, odometry.edge)
        if len(head.scans) >= HEAD and readings >= HEAD:
            break
    return head


def is_odometry_edge(edge: tuple[str, str], wanted: tuple[str, str] | None) -> bool:
    """Whether the edge is the one asked for, or by its parent's name gives odometry."""
    return edge == wanted if wanted else edge[0].rpartition("/")[2] in ODOMETRY_FRAMES


def frame_trees(source: Source, head: Head, warnings: list[str]) -> tuple[FrameTree, FrameTree]:
    """The tree of static edges, and with them the edges that do not move in the head.

    Edges that come with the scans are static if they stay the same; in a log that a mapping
    system has corrected they do not, and are no mount.
    """
    told = FrameTree(head.told)
    steady = told.without_moving()
    if told.frames() != steady.frames():
        warnings.append(
            "the poses of laser and robot in the records do not stay the same to each other: "
            "they are no mount (the log may have been corrected)"
        )
    static = FrameTree(source.static_transforms()).joined(steady)
    moving = [r.value for r in head.moving if isinstance(r.value, Transform)]
    return static, FrameTree(moving).without_moving().joined(static)
