"""The Wean Hall logs: lines `O x y theta t` and `L x y theta xl yl thetal r1 .. rn t`.

Lengths are centimetres. `x y theta` is the robot and `xl yl thetal` the laser, both in the
odometry's frame. The ranges span 180 degrees from right to left. Ranges from 8183 cm on are
codes of the laser for "no return".
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.logs import records as kinds
from hiermap_cli.logs.decimals import seconds_to_ns
from hiermap_cli.logs.ranges import SICK_FIRST_CODE, float32, translate
from hiermap_cli.logs.records import LaserGeometry, Odometry, Record, Scan, Topic, Transform
from hiermap_cli.logs.source import Part
from hiermap_cli.logs.textfile import text_lines

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

LASER, ODOMETRY = "L", "O"
_METRES = 0.01
_REACH = float32(SICK_FIRST_CODE)


class WeanLog:
    """A log of `L` and `O` records in one file or in several that follow each other."""

    format = "Wean"

    def __init__(self, paths: Sequence[Path]) -> None:
        self.paths = list(paths)
        self.twice: tuple[str, ...] = ()
        self.losses: list[str] = []

    def topics(self) -> list[Topic]:
        """Both records, whether or not they occur."""
        return [
            Topic(LASER, "Wean laser", "text", kinds.SCANS_WITH_ODOMETRY, None),
            Topic(ODOMETRY, "Wean odometry", "text", kinds.ODOMETRY, None),
        ]

    def static_transforms(self) -> Iterator[Transform]:
        """The mount comes with the first laser record."""
        yield from ()

    def records(self, wanted: frozenset[str] | None = None) -> Iterator[Record]:
        """Records in the order of lines."""
        self.losses = []
        mounted = False
        shapes: dict[str, tuple[int, int]] = {}
        for path in self.paths:
            for line in text_lines(path, self.losses):
                fields = line.split()
                if not fields or fields[0].startswith(b"#"):
                    continue
                topic = fields[0].decode("ascii", "replace")
                known = topic in (LASER, ODOMETRY)
                if known and wanted is not None and topic not in wanted:
                    continue
                if not known:
                    yield Record("", 0, None, "unknown record")
                    continue
                if shapes.setdefault(topic, _shape(fields)) != _shape(fields):
                    yield Record(topic, 0, None, "malformed line: not as long as the others")
                    continue
                try:
                    values = _laser(fields) if topic == LASER else [_reading(fields)]
                    mount = _mount(fields, values[0].stamp_ns) if topic == LASER else None
                except (ValueError, IndexError, OverflowError) as error:
                    yield Record(topic, 0, None, f"malformed line: {error}")
                    continue
                if mount is not None and not mounted:
                    mounted = True
                    yield Record(topic, values[0].stamp_ns, mount)
                for value in values:
                    yield Record(topic, value.stamp_ns, value)

    def parts(self) -> list[Part]:
        """The files; their times are in their lines only."""
        return [Part(WeanLog([path]), None) for path in self.paths]


def _shape(fields: list[bytes]) -> tuple[int, int]:
    """Number of fields, and of decimals of the stamp: a line that is cut off has fewer."""
    return len(fields), len(fields[-1].partition(b".")[2])


def _reading(fields: list[bytes]) -> Odometry:
    x, y, theta = (float(text) for text in fields[1:4])
    if len(fields) < 5:
        raise ValueError("no stamp")
    stamp_ns = seconds_to_ns(fields[-1])
    return Odometry(stamp_ns, x * _METRES, y * _METRES, theta, frame="odom", child="base")


def _laser(fields: list[bytes]) -> list[Odometry | Scan]:
    ranges = np.array([float(text) * _METRES for text in fields[7:-1]], dtype=np.float32)
    if len(ranges) < 2:
        raise ValueError(f"{len(ranges)} ranges")
    reading = _reading(fields)
    increment = math.pi / len(ranges)
    laser = LaserGeometry(float32(-0.5 * math.pi), float32(increment), len(ranges), 0.0, _REACH)
    return [reading, Scan(reading.stamp_ns, translate(ranges, 0.0, _REACH), laser, LASER)]


def _mount(fields: list[bytes], stamp_ns: int) -> Transform:
    """The laser's pose in the robot's frame; poses are printed with six decimals."""
    x, y, theta, xl, yl, thetal = (float(text) for text in fields[1:7])
    c, s = math.cos(theta), math.sin(theta)
    dx, dy = (xl - x) * _METRES, (yl - y) * _METRES
    half = 0.5 * round(math.remainder(thetal - theta, 2.0 * math.pi), 6)
    ahead, left = round(c * dx + s * dy, 6) + 0.0, round(c * dy - s * dx, 6) + 0.0
    rotation = (0.0, 0.0, math.sin(half), math.cos(half))
    return Transform(stamp_ns, "base", LASER, (ahead, left, 0.0), rotation)
