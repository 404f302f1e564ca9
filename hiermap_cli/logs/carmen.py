"""CARMEN logs: one record a line, plain or gzipped.

A record is a topic of its own (`FLASER`, `ODOM`, ...). Laser records that carry the robot's
odometry give an `Odometry` and then a `Scan` of the same stamp. The first stamp of a line, the
one before the host's name, is the record's own, the last one the recorder's.

Frames: `odom`, `base` and one for each laser, named like its record. What the log says of a
laser's mount (the PARAM lines, the laser's pose in a ROBOTLASER record) becomes a static
transform `base` -> laser.
"""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING

from hiermap_cli.logs import records as kinds
from hiermap_cli.logs.carmen_laser import (
    LASERS,
    CarmenScan,
    LaserLine,
    Pose,
    carmen_scan,
    carries_odometry,
    laser_line,
    laser_lines,
    pose_of,
    stamps_of,
)
from hiermap_cli.logs.ranges import HEAD_SCANS, infer_range_max, translate
from hiermap_cli.logs.raw import geometry
from hiermap_cli.logs.records import Odometry, Record, Scan, Topic, Transform
from hiermap_cli.logs.source import Part
from hiermap_cli.logs.textfile import text_lines

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

OTHERS = (b"PARAM", b"SYNC", b"NEFF", b"TRUEPOS", b"COMMENT", b"MARKER", b"NMEA-GGA", b"NMEA-RMC")
KNOWN = frozenset((*LASERS, *OTHERS, b"ODOM"))
SNIFF_LINES = 1000  # lines looked at for the topics of a log

_BATCH = 128  # lines read together

_FULL_CIRCLE = 2.0 * math.pi
_LASER_PARAMS = {b"offset": 0, b"side_offset": 1, b"angular_offset": 2}


class CarmenLog:
    """A CARMEN log in one file or in several that follow each other."""

    format = "CARMEN"

    def __init__(self, paths: Sequence[Path]) -> None:
        self.paths = list(paths)
        self.twice: tuple[str, ...] = ()
        self.losses: list[str] = []
        self._reach: dict[str, float] = {}
        self._ends: dict[bytes, int] = {}
        self._topics: list[Topic] | None = None

    def topics(self) -> list[Topic]:
        """Topics met up to the first scan and odometry, and in at least the first lines."""
        if self._topics is not None:
            return self._topics
        found: dict[bytes, None] = {}
        has_scan = has_odometry = False
        for number, line in enumerate(self._lines([])):
            if number >= SNIFF_LINES and has_scan and has_odometry:
                break
            name = _name(line)
            if name in KNOWN and name not in found:
                found[name] = None
                has_scan |= b"LASER" in name
                has_odometry |= name == b"ODOM" or carries_odometry(name)
        self._topics = [_topic(name) for name in found]
        return self._topics

    def static_transforms(self) -> Iterator[Transform]:
        """Mounts come with the records, before the first scan that they hold for."""
        yield from ()

    def records(self, wanted: frozenset[str] | None = None) -> Iterator[Record]:
        """Records in the order of lines."""
        self.losses = []
        params: dict[bytes, list[float]] = {}
        told: dict[str, list[Pose]] = {}
        lines = self._lines(self.losses)
        while batch := list(islice(lines, _BATCH)):
            names = [_name(line) for line in batch]
            read = laser_lines([n if _is_wanted(n, wanted) else b"" for n in names], batch)
            for place, (name, line) in enumerate(zip(names, batch, strict=True)):
                if name == b"PARAM":
                    _note_param(line, params)
                if name.startswith(b"#"):
                    continue
                if name not in KNOWN:
                    topic = name.decode("ascii", "replace") if name.isupper() else ""
                    yield Record(topic, 0, None, "unknown record")
                elif _is_wanted(name, wanted):
                    yield from self._records(name, line, read.get(place), params, told)

    def parts(self) -> list[Part]:
        """The files; their times are in their lines only."""
        return [Part(CarmenLog([path]), None) for path in self.paths]

    def _records(
        self,
        name: bytes,
        line: bytes,
        read: LaserLine | None,
        params: dict[bytes, list[float]],
        told: dict[str, list[Pose]],
    ) -> Iterator[Record]:
        """What a line holds; `read` where its ranges are read already."""
        topic = name.decode()
        try:
            if name == b"ODOM":
                yield self._odometry(line)
                return
            if name not in LASERS:
                yield _other(topic, line)
                return
            raw = carmen_scan(name, read or laser_line(name, line), self._ends)
        except (ValueError, IndexError, OverflowError) as error:
            yield Record(topic, 0, None, f"malformed line: {error}")
            return
        mount = _mount(name, params, raw)
        tellings = told.setdefault(topic, [])
        if mount is not None and mount not in tellings[-1:] and len(tellings) < HEAD_SCANS:
            tellings.append(mount)
            yield Record(topic, raw.log_ns, _mount_transform(raw.stamp_ns, topic, mount))
        if raw.robot is not None:
            reading = Odometry(raw.stamp_ns, *raw.robot, frame="odom", child="base")
            yield Record(topic, raw.log_ns, reading)
        reach, beams = self._reach_of(topic), len(raw.ranges)
        laser = geometry(raw.angle_min, raw.angle_increment, beams, 0.0, raw.range_max, reach)
        scan = Scan(raw.stamp_ns, translate(raw.ranges, 0.0, laser.range_max), laser, topic)
        yield Record(topic, raw.log_ns, scan)

    def _odometry(self, line: bytes) -> Record:
        """`ODOM x y theta tv rv accel stamp host logger_stamp`."""
        words = line.split()
        pose = pose_of(words[1:4])
        stamp_ns, log_ns = stamps_of(b"ODOM", words[7:], self._ends)
        return Record("ODOM", log_ns, Odometry(stamp_ns, *pose, frame="odom", child="base"))

    def _lines(self, losses: list[str]) -> Iterator[bytes]:
        for path in self.paths:
            yield from text_lines(path, losses)

    def _reach_of(self, topic: str) -> float:
        """The range at which the laser saturates, from its own first scans in the log."""
        if topic not in self._reach:
            name = topic.encode()
            lines = (line for line in self._lines([]) if line.startswith(name))
            lines = (line for line in lines if _name(line) == name)
            head: list[NDArray[np.float32]] = []
            while batch := list(islice(lines, HEAD_SCANS - len(head))):
                together = laser_lines([name] * len(batch), batch)
                for place, line in enumerate(batch):
                    with suppress(ValueError, IndexError, OverflowError):
                        head.append((together.get(place) or laser_line(name, line)).ranges)
            self._reach[topic] = infer_range_max(head)
        return self._reach[topic]


def _name(line: bytes) -> bytes:
    """The record's name; # for an empty line."""
    words = line[:24].split(None, 1)
    return words[0] if words else b"#"


def _is_wanted(name: bytes, wanted: frozenset[str] | None) -> bool:
    return wanted is None or name.decode("ascii", "replace") in wanted


def _topic(name: bytes) -> Topic:
    if b"LASER" in name:
        kind = kinds.SCANS_WITH_ODOMETRY if carries_odometry(name) else kinds.SCANS
    else:
        kind = kinds.ODOMETRY if name == b"ODOM" else kinds.OTHER
    return Topic(name.decode(), f"CARMEN {name.decode()}", "text", kind, None)


def _other(topic: str, line: bytes) -> Record:
    """A record that is of no use here."""
    fields = line.rsplit(None, 3)
    log_ns = stamps_of(b"", fields[1:], {})[1] if len(fields) == 4 else 0
    return Record(topic, log_ns, None)


def _note_param(line: bytes, params: dict[bytes, list[float]]) -> None:
    """`PARAM robot_frontlaser_offset 0.2`, `_side_offset`, `_angular_offset`; rear alike."""
    fields = line.split()
    if len(fields) < 3:
        return
    for prefix, name in ((b"robot_frontlaser_", b"FLASER"), (b"robot_rearlaser_", b"RLASER")):
        if fields[1].startswith(prefix):
            index = _LASER_PARAMS.get(fields[1][len(prefix) :])
            try:
                value = float(fields[2])
            except ValueError:
                return
            if index is not None and math.isfinite(value):
                pose = params.setdefault(name, [0.0, 0.0, math.pi if name == b"RLASER" else 0.0])
                pose[index] = value


def _mount(name: bytes, params: dict[bytes, list[float]], raw: CarmenScan) -> Pose | None:
    """What the log says of the laser's pose on the robot, None where it says nothing.

    A PARAM goes before the poses of the record itself. In logs that a mapping system has
    corrected those poses are no mount: whoever reads must see whether they stay the same.
    """
    side = b"RLASER" if name in (b"RLASER", b"ROBOTLASER2", b"RAWLASER2") else b"FLASER"
    if side in params:
        x, y, theta = params[side]
        return x, y, theta
    if raw.robot is not None and raw.laser_pose is not None and raw.laser_pose != raw.robot:
        (x, y, theta), (xl, yl, thetal) = raw.robot, raw.laser_pose
        c, s = math.cos(theta), math.sin(theta)
        dx, dy = xl - x, yl - y
        yaw = math.remainder(thetal - theta, _FULL_CIRCLE)
        # Poses are printed with few decimals: finer differences are rounding.
        return (
            round(c * dx + s * dy, 3) + 0.0,
            round(c * dy - s * dx, 3) + 0.0,
            round(yaw, 3) + 0.0 if abs(yaw) < 3.141 else math.pi,
        )
    return (0.0, 0.0, math.pi) if name == b"RLASER" else None


def _mount_transform(stamp_ns: int, topic: str, mount: Pose) -> Transform:
    x, y, yaw = mount
    return Transform(
        stamp_ns,
        "base",
        topic,
        (x, y, 0.0),
        (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)),
    )
