"""Adaptive breakpoints: where one surface ends and another begins.

Two neighbouring returns belong to one surface when a wall at the steepest incidence that is still
believed explains their distance (Borges and Aldon 2004), or when the range goes on as the wall
before and behind foretells: along a line the inverse range is a sinusoid of the bearing, so that
walls seen at grazing incidence stay whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams

SAMPLE = 1500  # triples of beams that are looked at for the noise of a block


def breakpoints(beams: Beams, laser: LaserConfig, config: SegmentationConfig) -> NDArray[np.bool_]:
    """True for each point (N,) that begins a new surface in its scan.

    Across the seam of a full circle there is always a breakpoint; the merge looks over it.
    """
    total = len(beams.cell)
    breaks = np.ones(total, dtype=bool)
    if total < 2:
        return breaks
    count, width = beams.ranges.shape
    cell, r = beams.cell, beams.r
    noise = 3.0 * np.sqrt(2.0) * laser.sigma_range
    steps = np.arange(config.max_gap_beams + 2) * beams.spacing
    below = steps < 0.9 * config.breakpoint_angle
    ratio = np.ones(len(steps))
    ratio[below] = np.sin(steps[below]) / np.sin(config.breakpoint_angle - steps[below])
    allowed = np.minimum(r[1:], r[:-1])
    allowed *= ratio[1] + 3.0 * np.sqrt(2.0) * laser.sigma_range_scale
    allowed += noise
    across, term = np.diff(beams.x), np.diff(beams.y)
    across *= across
    term *= term
    across += term
    gap = np.diff(cell)
    wide = np.flatnonzero(gap > 1)
    allowed[wide] *= ratio[np.minimum(gap[wide], len(steps) - 1)] / ratio[1]
    allowed *= allowed
    apart = across > allowed
    suspect = np.flatnonzero(apart)
    suspect = suspect[gap[suspect] == 1]
    if len(suspect):
        apart[suspect[_runs_on(beams, laser, suspect)]] = False
    # Across beams that say nothing a surface goes on, but not across free space.
    between = cell[wide] + np.arange(1, config.max_gap_beams + 1)[:, None]
    between = np.minimum(between, cell[wide + 1])
    free = np.isposinf(beams.ranges.ravel()[between]).any(axis=0)
    apart[wide] |= free | (gap[wide] > config.max_gap_beams + 1)
    breaks[1:] = apart
    breaks[np.searchsorted(cell, np.arange(0, count * width, width)[:count]) % total] = True
    return breaks


def _runs_on(beams: Beams, laser: LaserConfig, suspect: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether the jump from point i to i + 1 is one that a straight wall makes at its beams."""
    inside = (suspect >= 1) & (suspect + 2 < len(beams.cell))
    # The four points (4, K): two on either side of the jump.
    four = np.minimum(np.maximum(suspect, 1), len(beams.cell) - 3) + np.arange(-1, 3)[:, None]
    inside &= beams.cell.take(four[3]) - beams.cell.take(four[0]) == 3
    r = beams.r.take(four)
    q = 1.0 / r
    noise = (laser.sigma_range + laser.sigma_range_scale * r) * q * q
    noise *= noise
    twice = 2.0 * np.cos(beams.spacing)
    left = q[0] - twice * q[1] + q[2]
    right = q[1] - twice * q[2] + q[3]
    bound_left = 3.0 * np.sqrt(noise[0] + 4.0 * noise[1] + noise[2])
    bound_right = 3.0 * np.sqrt(noise[1] + 4.0 * noise[2] + noise[3])
    # The jump itself must stand out of the noise, or anything would be straight.
    jump = np.abs(q[2] - q[1])
    decided = jump > 2.0 * np.maximum(bound_left, bound_right)
    fits = (np.abs(left) < bound_left) & (np.abs(right) < bound_right)
    return np.asarray(inside & decided & fits)


def shown_noise(beams: Beams) -> float:
    """The noise of a range that the scans themselves show, metres; inf where too little is seen.

    Along a wall the inverse ranges of three neighbouring beams obey
    q[i - 1] - 2 cos(spacing) q[i] + q[i + 1] = 0; the median of what is left over is the noise's,
    as most triples lie on something straight.
    """
    middle = np.arange(1, len(beams.cell) - 1, max(1, len(beams.cell) // SAMPLE))
    middle = middle[beams.cell[middle + 1] - beams.cell[middle - 1] == 2]
    if len(middle) < 10:
        return np.inf
    q = 1.0 / beams.r[middle[:, None] + np.array((-1, 0, 1))]
    left_over = q[:, 0] - 2.0 * np.cos(beams.spacing) * q[:, 1] + q[:, 2]
    error = np.abs(left_over) * beams.r[middle] ** 2
    # Their median; numpy's own asks for every kind of array first.
    half = len(error) // 2
    error.partition((half - 1, half))
    median = error[half] if len(error) % 2 else 0.5 * (error[half - 1] + error[half])
    return float(median / (0.6745 * np.sqrt(6.0)))
