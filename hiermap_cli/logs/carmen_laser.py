"""The laser records of CARMEN logs, the short ones of old and the long ones of newer logs.

    FLASER n r1 .. rn x y theta odom_x odom_y odom_theta stamp host logger_stamp
    ROBOTLASER1 type start fov step max accuracy remission n r1 .. rn m i1 .. im
        laser_x laser_y laser_theta x y theta 5 values more, stamp host logger_stamp

LASER3 and RAWLASER1 are the same without poses. The stamp before the host's name is the
record's own, the last one the recorder's.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.logs.decimal_table import read_table
from hiermap_cli.logs.decimals import seconds_to_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

Pose = tuple[float, float, float]

SHORT_LASERS = (b"FLASER", b"RLASER", b"LASER3", b"LASER4", b"LASER5")
LONG_LASERS = tuple(b"%sLASER%d" % (kind, i) for kind in (b"ROBOT", b"RAW") for i in range(1, 6))
LASERS = frozenset((*SHORT_LASERS, *LONG_LASERS))

_TIMED = LASERS | {b"ODOM"}
_FARTHEST = 1e30
_FULL_CIRCLE = 2.0 * math.pi
_FEWEST = 4  # lines that are worth reading together


class LaserLine(NamedTuple):
    """A line in three parts: the words before the ranges, the ranges, the words behind."""

    head: list[bytes]
    ranges: NDArray[np.float32]
    rest: list[bytes]


class CarmenScan(NamedTuple):
    """A laser record before its ranges are translated."""

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


_floats = _Floats()


def carries_odometry(name: bytes) -> bool:
    """Whether such records have the robot's pose by odometry."""
    return name in (b"FLASER", b"RLASER") or name.startswith(b"ROBOTLASER")


def laser_line(name: bytes, line: bytes) -> LaserLine:
    """One line by itself. Raises ValueError or IndexError where it is none."""
    words = line.split()
    skip = _skip(name)
    beams = int(words[skip - 1])
    texts = words[skip : skip + beams]
    if not 0 <= beams == len(texts):
        raise ValueError(f"{beams} ranges announced, {len(texts)} there")
    ranges = np.fromiter(map(_floats.__getitem__, texts), dtype=np.float32, count=beams)
    return LaserLine(words[:skip], ranges, words[skip + beams :])


def laser_lines(names: Sequence[bytes], lines: Sequence[bytes]) -> dict[int, LaserLine]:
    """Those of many lines that can be read together, by their place.

    Lines of one kind and number of beams are; where one of them is unusual, they are left out
    all, for `laser_line`.
    """
    groups: dict[tuple[bytes, bytes], list[int]] = {}
    for place, name in enumerate(names):
        if name in LASERS:
            skip = _skip(name)
            words = lines[place].split(None, skip)
            if len(words) > skip:
                groups.setdefault((name, words[skip - 1]), []).append(place)
    out: dict[int, LaserLine] = {}
    for (name, beams), places in groups.items():
        skip = _skip(name)
        if len(places) < _FEWEST or not beams.isdigit() or not 0 < int(beams) < 1 << 16:
            continue
        table = read_table([lines[place] for place in places], skip, int(beams))
        if table is not None:
            for place, ranges, end in zip(places, table.values, table.ends.tolist(), strict=True):
                head = lines[place].split(None, skip)[:skip]
                out[place] = LaserLine(head, ranges, lines[place][end:].split())
    return out


def _skip(name: bytes) -> int:
    """Words before the ranges."""
    return 2 if name in SHORT_LASERS else 9


def carmen_scan(name: bytes, line: LaserLine, ends: dict[bytes, int]) -> CarmenScan:
    """The record of a line. `ends` keeps how many words follow the poses, by kind.

    Raises ValueError or IndexError where the line is cut off.
    """
    beams, rest = len(line.ranges), line.rest
    range_max = None
    if name in SHORT_LASERS:
        # 181 beams reach from -90 to +90 degrees, 180 stop one step before: CARMEN's custom.
        steps = beams - 1 if beams > 1 and (beams - 1) % 90 == 0 else max(beams, 1)
        start, step = -0.5 * math.pi, math.pi / steps
        more = 0
    else:
        start, fov, step, reach = (float(text) for text in line.head[2:6])
        if not (math.isfinite(start) and 0 < abs(step) < _FULL_CIRCLE):
            step = fov / max(beams - 1, 1)
        range_max = reach if math.isfinite(reach) and reach > 0 else None
        rest = rest[1 + int(rest[0]) :]  # the remissions
        more = 5
    laser_pose = robot = None
    if carries_odometry(name):
        laser_pose, robot = pose_of(rest[0:3]), pose_of(rest[3:6])
        rest = rest[6 + more :]
    stamp_ns, log_ns = stamps_of(name, rest, ends)
    return CarmenScan(
        name.decode(), stamp_ns, log_ns, line.ranges, start, step, range_max, robot, laser_pose
    )


def pose_of(texts: Sequence[bytes]) -> Pose:
    """Three numbers. Raises ValueError where they are none."""
    x, y, theta = map(float, texts)
    return x, y, theta


def stamps_of(name: bytes, rest: Sequence[bytes], ends: dict[bytes, int]) -> tuple[int, int]:
    """The stamps that end a line, in nanoseconds; 0 where there is none to use.

    A line whose end is shorter than that of the first of its kind is cut off; one with another
    record in its end has lost the line break between the two. Both raise ValueError.
    """
    length = ends.setdefault(name, len(rest))
    if len(rest) < length or (len(rest) > length and not _TIMED.isdisjoint(rest)):
        raise ValueError("cut off, or two lines in one")
    stamp_ns = _stamp(rest[0]) if rest else 0
    if len(rest) < 3 or rest[2] == rest[0]:
        return stamp_ns, stamp_ns
    return stamp_ns, _stamp(rest[2])


def _stamp(text: bytes) -> int:
    try:
        return seconds_to_ns(text)
    except ValueError:
        return 0
