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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.logs import records as kinds
from hiermap_cli.logs.decimals import seconds_to_ns
from hiermap_cli.logs.ranges import HEAD_SCANS, float32, infer_range_max, translate
from hiermap_cli.logs.records import LaserGeometry, Odometry, Record, Scan, Topic, Transform
from hiermap_cli.logs.textfile import text_lines

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

Pose = tuple[float, float, float]

SHORT_LASERS = (b"FLASER", b"RLASER", b"LASER3", b"LASER4", b"LASER5")
LONG_LASERS = tuple(b"%sLASER%d" % (kind, i) for kind in (b"ROBOT", b"RAW") for i in range(1, 6))
OTHERS = (b"PARAM", b"SYNC", b"NEFF", b"TRUEPOS", b"COMMENT", b"MARKER", b"NMEA-GGA", b"NMEA-RMC")
KNOWN = frozenset((*SHORT_LASERS, *LONG_LASERS, *OTHERS, b"ODOM"))
SNIFF_LINES = 4000  # lines looked at for the topics of a log

_FARTHEST = 1e30
_FULL_CIRCLE = 2.0 * math.pi
_LASER_PARAMS = {b"offset": 0, b"side_offset": 1, b"angular_offset": 2}


class RawScan(NamedTuple):
    """A laser line before its ranges are translated. Poses are `(x, y, theta)` or None."""

    topic: str
    stamp_ns: int
    log_ns: int
    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_max: float | None
    robot: Pose | None
    laser_pose: Pose | None


class _Floats(dict[bytes, float]):
    """Texts of numbers already met: ranges have few distinct values, so looking up is faster.

    The number of entries is bounded.
    """

    def __missing__(self, text: bytes) -> float:
        value = float(text)
        if abs(value) > _FARTHEST:
            value = math.inf  # float32 holds no more
        if len(self) < 1 << 16:
            self[text] = value
        return value


class CarmenLog:
    """A CARMEN log in one file or in several that follow each other."""

    format = "CARMEN"

    def __init__(self, paths: Sequence[Path]) -> None:
        self.paths = list(paths)
        self.losses: list[str] = []
        self._floats = _Floats()
        self._reach: dict[str, float] = {}
        self._ends: dict[bytes, int] = {}
        self._lasers: dict[tuple[str, int, float, float, float | None], LaserGeometry] = {}

    def topics(self) -> list[Topic]:
        """Topics met up to the first scan and odometry, and in at least the first lines."""
        found: dict[bytes, None] = {}
        has_scan = has_odometry = False
        for number, line in enumerate(self._lines([])):
            if number >= SNIFF_LINES and has_scan and has_odometry:
                break
            name = line[:24].split(None, 1)[0] if line.strip() else b""
            if name in KNOWN and name not in found:
                found[name] = None
                has_scan |= b"LASER" in name
                has_odometry |= name == b"ODOM" or _carries_odometry(name)
        return [_topic(name) for name in found]

    def static_transforms(self) -> Iterator[Transform]:
        """Mounts come with the records, before the first scan that they hold for."""
        yield from ()

    def records(self, wanted: frozenset[str] | None = None) -> Iterator[Record]:
        """Records in the order of lines."""
        self.losses = []
        params: dict[bytes, list[float]] = {}
        told: dict[str, list[Pose]] = {}
        for line in self._lines(self.losses):
            name = line[:24].split(None, 1)[0] if line and not line.isspace() else b"#"
            if name.startswith(b"#"):
                continue
            topic = name.decode("ascii", "replace")
            if name == b"PARAM":
                _note_param(line, params)
            if name not in KNOWN:
                yield Record(topic if name.isupper() else "", 0, None, "unknown record")
                continue
            if wanted is not None and topic not in wanted:
                continue
            try:
                if b"LASER" in name and name in KNOWN:
                    raw = self._laser(name, line)
                elif name == b"ODOM":
                    yield self._odometry(line)
                    continue
                else:
                    yield _other(topic, line)
                    continue
            except (ValueError, IndexError, OverflowError) as error:
                yield Record(topic, 0, None, f"malformed line: {error}")
                continue
            mount = _mount(name, params, raw)
            tellings = told.setdefault(topic, [])
            if mount is not None and mount not in tellings[-1:] and len(tellings) < HEAD_SCANS:
                tellings.append(mount)
                yield Record(topic, raw.log_ns, _mount_transform(raw.stamp_ns, topic, mount))
            yield from self._scan(raw)

    def _lines(self, losses: list[str]) -> Iterator[bytes]:
        for path in self.paths:
            yield from text_lines(path, losses)

    def _laser(self, name: bytes, line: bytes) -> RawScan:
        fields = line.split()
        return (
            self._short_laser(name, fields)
            if name in SHORT_LASERS
            else self._long_laser(name, fields)
        )

    def _ranges(self, texts: list[bytes], beams: int) -> NDArray[np.float32]:
        if not 0 <= beams == len(texts):
            raise ValueError(f"{beams} ranges announced, {len(texts)} there")
        return np.fromiter(map(self._floats.__getitem__, texts), dtype=np.float32, count=beams)

    def _short_laser(self, name: bytes, fields: list[bytes]) -> RawScan:
        """`FLASER n r1..rn x y theta odom_x odom_y odom_theta stamp host logger_stamp`."""
        beams = int(fields[1])
        ranges = self._ranges(fields[2 : 2 + beams], beams)
        rest = fields[2 + beams :]
        laser_pose = robot = None
        if _carries_odometry(name):
            laser_pose, robot = _pose(rest[0:3]), _pose(rest[3:6])
            rest = rest[6:]
        stamp_ns, log_ns = self._stamps_of(name, rest)
        # 181 beams reach from -90 to +90 degrees, 180 stop one step before: CARMEN's custom.
        steps = beams - 1 if beams > 1 and (beams - 1) % 90 == 0 else max(beams, 1)
        return RawScan(
            name.decode(),
            stamp_ns,
            log_ns,
            ranges,
            -0.5 * math.pi,
            math.pi / steps,
            None,
            robot,
            laser_pose,
        )

    def _long_laser(self, name: bytes, fields: list[bytes]) -> RawScan:
        """`ROBOTLASER1 type start fov step max accuracy remission n r1..rn m i1..im ...`."""
        start, fov, step, range_max = (float(text) for text in fields[2:6])
        beams = int(fields[8])
        ranges = self._ranges(fields[9 : 9 + beams], beams)
        remissions = int(fields[9 + beams])
        rest = fields[10 + beams + remissions :]
        laser_pose = robot = None
        if _carries_odometry(name):
            laser_pose, robot = _pose(rest[0:3]), _pose(rest[3:6])
            rest = rest[11:]
        if not (math.isfinite(start) and 0 < abs(step) < _FULL_CIRCLE):
            step = fov / max(beams - 1, 1)
        stamp_ns, log_ns = self._stamps_of(name, rest)
        stated = range_max if math.isfinite(range_max) and range_max > 0 else None
        return RawScan(
            name.decode(), stamp_ns, log_ns, ranges, start, step, stated, robot, laser_pose
        )

    def _odometry(self, line: bytes) -> Record:
        """`ODOM x y theta tv rv accel stamp host logger_stamp`."""
        fields = line.split()
        pose = _pose(fields[1:4])
        stamp_ns, log_ns = self._stamps_of(b"ODOM", fields[7:])
        return Record("ODOM", log_ns, Odometry(stamp_ns, *pose, frame="odom", child="base"))

    def _stamps_of(self, name: bytes, rest: list[bytes]) -> tuple[int, int]:
        """The stamps that end a line.

        A line whose end is shorter than that of the first of its kind is cut off; one with
        another record in its end has lost the line break between the two.
        """
        length = self._ends.setdefault(name, len(rest))
        if len(rest) < length or (len(rest) > length and not KNOWN.isdisjoint(rest)):
            raise ValueError("cut off, or two lines in one")
        return _stamps(rest)

    def _scan(self, raw: RawScan) -> Iterator[Record]:
        topic = raw.topic
        if raw.robot is not None:
            reading = Odometry(raw.stamp_ns, *raw.robot, frame="odom", child="base")
            yield Record(topic, raw.log_ns, reading)
        laser = self._laser_of(raw)
        scan = Scan(raw.stamp_ns, translate(raw.ranges, 0.0, laser.range_max), laser, topic)
        yield Record(topic, raw.log_ns, scan)

    def _laser_of(self, raw: RawScan) -> LaserGeometry:
        key = (raw.topic, len(raw.ranges), raw.angle_min, raw.angle_increment, raw.range_max)
        laser = self._lasers.get(key)
        if laser is None:
            reach = self._reach_of(raw.topic)
            if raw.range_max is not None:
                reach = min(reach, float32(raw.range_max))
            start, step = float32(raw.angle_min), float32(raw.angle_increment)
            laser = LaserGeometry(start, step, len(raw.ranges), 0.0, reach)
            if len(self._lasers) < HEAD_SCANS:
                self._lasers[key] = laser
        return laser

    def _reach_of(self, topic: str) -> float:
        """The range at which the laser saturates, from its own first scans in the log."""
        if topic not in self._reach:
            name = topic.encode()
            head: list[NDArray[np.float32]] = []
            for line in self._lines([]):
                if line.startswith(name) and line[:24].split(None, 1)[0] == name:
                    try:
                        head.append(self._laser(name, line).ranges)
                    except (ValueError, IndexError, OverflowError):
                        continue
                    if len(head) == HEAD_SCANS:
                        break
            self._reach[topic] = infer_range_max(head)
        return self._reach[topic]


def _carries_odometry(name: bytes) -> bool:
    return name in (b"FLASER", b"RLASER") or name.startswith(b"ROBOTLASER")


def _topic(name: bytes) -> Topic:
    if b"LASER" in name:
        kind = kinds.SCANS_WITH_ODOMETRY if _carries_odometry(name) else kinds.SCANS
    else:
        kind = kinds.ODOMETRY if name == b"ODOM" else kinds.OTHER
    return Topic(name.decode(), f"CARMEN {name.decode()}", "text", kind, None)


def _pose(texts: list[bytes]) -> Pose:
    x, y, theta = (float(text) for text in texts)
    return x, y, theta


def _stamps(rest: list[bytes]) -> tuple[int, int]:
    """The record's stamp and the recorder's, in nanoseconds; 0 where there is none to use."""
    stamp_ns = _stamp(rest[0]) if rest else 0
    if len(rest) < 3 or rest[2] == rest[0]:
        return stamp_ns, stamp_ns
    return stamp_ns, _stamp(rest[2])


def _stamp(text: bytes) -> int:
    try:
        return seconds_to_ns(text)
    except ValueError:
        return 0


def _other(topic: str, line: bytes) -> Record:
    """A record that is of no use here."""
    fields = line.rsplit(None, 3)
    return Record(topic, _stamps(fields[1:])[1] if len(fields) == 4 else 0, None)


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


def _mount(name: bytes, params: dict[bytes, list[float]], raw: RawScan) -> Pose | None:
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
