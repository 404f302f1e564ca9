"""Scans as their messages say them, before no-return conventions are translated."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.logs.ranges import SICK_FIRST_CODE, float32, translate
from hiermap_cli.logs.records import LaserGeometry, Scan

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class RawScan(NamedTuple):
    """Ranges (beams,) in metres; `range_max` is None where the message states none."""

    stamp_ns: int
    frame: str
    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float | None


def stated(range_min: float, range_max: float) -> float | None:
    """The stated reach, None where the number cannot be one."""
    return range_max if math.isfinite(range_max) and range_max > max(range_min, 0.0) else None


def finish(raw: RawScan, reach: float) -> Scan:
    """The scan with its ranges translated; `reach` counts where it is the nearer limit."""
    laser = geometry(
        raw.angle_min, raw.angle_increment, len(raw.ranges), raw.range_min, raw.range_max, reach
    )
    ranges = translate(raw.ranges, laser.range_min, laser.range_max)
    return Scan(raw.stamp_ns, ranges, laser, raw.frame)


@lru_cache(maxsize=256)
def geometry(
    angle_min: float,
    angle_increment: float,
    beams: int,
    range_min: float,
    range_max: float | None,
    reach: float,
) -> LaserGeometry:
    """The geometry in numbers that float32 holds; nearly all scans of a log have the same."""
    return LaserGeometry(
        float32(angle_min),
        float32(angle_increment),
        beams,
        float32(range_min) if 0.0 < range_min < SICK_FIRST_CODE else 0.0,
        reach if range_max is None else min(reach, float32(range_max)),
    )
