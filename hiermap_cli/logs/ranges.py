"""No-return conventions of laser makers, translated into +inf (nothing there) and nan.

Three rules cover all formats:

1. A range that is nan, zero, negative or below the laser's `range_min` says nothing: nan.
2. A range of +inf or of `range_max` and more means that nothing was in reach: +inf.
3. Where the log does not state `range_max`, it is found once, from the first scans: see
   `infer_range_max`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

# SICK's LMS counts in centimetres up to 8183; 8183 to 8191 are its codes for "no return",
# "dazzled" and the like. A log without a stated maximum has this limit unless its data say
# otherwise: no laser of these formats sees farther.
SICK_FIRST_CODE = 81.83
SICK_LAST_CODE = 81.91

# Values at which known lasers and drivers saturate (metres): SICK's 8, 16, 32 and 80 m modes,
# Hokuyo's, and what CARMEN's own parameters say for them.
KNOWN_MAXIMA = (
    4.095, 5.6, 8.183, 8.187, 8.19, 8.191, 16.38, 16.383, 29.99, 30.0, 32.766, 32.767, 50.0,
    65.533, 65.535, 80.0, 81.0,
)  # fmt: skip
LEAST_SATURATION = 4.0  # metres; no laser for robots reaches less far

_NOTHING = np.float32(np.inf)
_LEAST = 1e-30  # metres; the least float32 that is not zero for anybody

HEAD_SCANS = 64  # scans that `infer_range_max` is given by the readers


def float32(value: float) -> float:
    """The nearest number that a float32 holds.

    Geometries hold such numbers only, so that a log and its conversion to ROS messages, whose
    fields are float32, are the same to the last bit.
    """
    with np.errstate(over="ignore"):
        return float(np.float32(value))


def translate(
    ranges: NDArray[np.float32], range_min: float, range_max: float
) -> NDArray[np.float32]:
    """Ranges (beams,) in metres by rules 1 and 2, as a new array.

    `range_min` and `range_max` must be numbers that float32 holds (`float32`).
    """
    out = np.array(ranges, dtype=np.float32)
    np.putmask(out, out >= range_max, _NOTHING)
    # The comparisons are written so that nan fails them, and zero too where range_min is zero.
    least = max(range_min, _LEAST)
    if not out.min(initial=_NOTHING) >= least:
        np.putmask(out, ~(out >= least), np.nan)
    return out


def infer_range_max(head: Sequence[NDArray[np.float32]]) -> float:
    """Rule 3: the range at which a laser of unstated reach saturates, from its first scans.

    The largest finite value of the first scans is a saturation if it is rare enough not to be
    the room (at most half of all values), occurs five times as often as all the values of the
    last tenth below it, and is one of KNOWN_MAXIMA and there at least three times; or any other
    value from LEAST_SATURATION on that several beams of a scan have at once: ten times in all,
    four times in the mean of the scans that have it. Without a saturation the limit is
    SICK_FIRST_CODE; where most values are beyond what any laser sees, there is none. The answer
    depends on the first scans alone, never on how a log is cut into blocks.
    """
    values = [r[np.isfinite(r) & (r > 0)] for r in head]
    pooled = np.concatenate(values) if values else np.empty(0, dtype=np.float32)
    if not len(pooled):
        return float32(SICK_FIRST_CODE)
    if float(np.median(pooled)) > SICK_LAST_CODE:
        # No laser sees so far: these are no metres. They are kept, for a person to see.
        return float32(1e6)
    top = float(pooled.max())
    if top >= SICK_FIRST_CODE - 1e-4:
        return float32(SICK_FIRST_CODE)
    by_scan = [int(np.count_nonzero(r == np.float32(top))) for r in values]
    count, scans = sum(by_scan), sum(n > 0 for n in by_scan)
    near = int(np.count_nonzero(pooled > np.float32(0.9 * top))) - count
    if count < 5 * near or 2 * count > len(pooled):
        return float32(SICK_FIRST_CODE)
    known = any(math.isclose(top, value, abs_tol=1e-4) for value in KNOWN_MAXIMA)
    several = top >= LEAST_SATURATION and count >= 10 and count >= 4 * scans
    return float32(top) if (known and count >= 3) or several else float32(SICK_FIRST_CODE)
