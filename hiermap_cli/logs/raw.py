"""Scans as their messages say them, before no-return conventions are translated."""

from __future__ import annotations

import math
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
    range_min = float32(raw.range_min) if 0.0 < raw.range_min < SICK_FIRST_CODE else 0.0
    range_max = reach if raw.range_max is None else min(reach, float32(raw.range_max))
    laser = LaserGeometry(
        float32(raw.angle_min),
        float32(raw.angle_increment),
        len(raw.ranges),
        range_min,
        range_max,
    )
    return Scan(raw.stamp_ns, translate(raw.ranges, range_min, range_max), laser, raw.frame)
