"""The ends of segments: points gained beyond them, tails that the inner points do not foretell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.perception.beams import concatenated_ranges
from hiermap_cli.perception.fitting import few_moments, fit_moments, least_scatter, run_moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams
    from hiermap_cli.perception.fitting import Lines, Members

    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

TAIL = 4  # points at each end that must be foretold by the others
GAIN = 6  # points that a segment may gain beyond each end

# Two-sided 99.9 % quantiles of Student's t for 1, 2, .. 20 degrees of freedom, then the normal's.
STUDENT = np.array(
    (
        *(636.6, 31.60, 12.92, 8.610, 6.869, 5.959, 5.408, 5.041, 4.781, 4.587),
        *(4.437, 4.318, 4.221, 4.140, 4.073, 4.015, 3.965, 3.922, 3.883, 3.850),
        3.291,
    )
)


def gain_points(
    beams: Beams,
    breaks: Mask,
    lines: Lines,
    first: Index,
    last: Index,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> tuple[Index, Index]:
    """New first and last points of the runs (R,) that gain single points beyond a breakpoint.

    Far along a wall the returns stand so wide apart that each is a surface of its own; those next
    to a segment's end that lie on its line are its own.

    Args:
        beams: the block.
        breaks: (N,) where surfaces begin.
        lines: (R,) of the segments of the runs.
        first: (R,) first points of the runs, in order.
        last: (R,) last points.
        laser: noise of ranges.
        config: how uneven a wall may be.
    """
    total = len(beams.cell)
    free = np.ones(total + 2, dtype=bool)
    free[concatenated_ranges(first, last - first + 1)] = False
    free[total:] = False  # also what index -1 asks
    low, high = first.copy(), last.copy()
    for end, out, step in ((first, low, -1), (last, high, 1)):
        neighbour = np.clip(end + step, 0, total - 1)
        # Points of the same surface were split off on purpose.
        some = np.flatnonzero(free[end + step] & breaks[end if step < 0 else neighbour])
        fits = _on_line(beams, lines.take(some), end[some, None], step, 1, laser, config)
        some = some[fits[:, 0]]
        line, at = lines.take(some), end[some, None]
        fits = _on_line(beams, line, at, step, GAIN, laser, config)
        fits &= free[np.clip(at + step * np.arange(1, GAIN + 1), 0, total)]
        out[some] += step * np.minimum.accumulate(fits, axis=1).sum(axis=1)
    # What two segments both would gain goes to neither.
    shared = np.flatnonzero(low[1:] <= high[:-1])
    low[shared + 1], high[shared] = first[shared + 1], last[shared]
    return low, high


def _on_line(
    beams: Beams,
    lines: Lines,
    end: Index,
    step: int,
    many: int,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Mask:
    """Which of the `many` next points of ends (K, 1) follow on the lines (K,) without a gap."""
    total, width = len(beams.cell), beams.ranges.shape[1]
    point = np.clip(end + step * np.arange(many + 1), 0, total - 1)
    near, cell = point[:, 1:], beams.cell[point]
    between = np.abs(np.diff(cell, axis=1)) - 1
    fits = (between >= 0) & (between <= config.max_gap_beams)
    fits &= cell[:, 1:] // width == cell[:, :1] // width
    sigma = laser.sigma_range + laser.sigma_range_scale * beams.r[near]
    nx, ny, d = (v[:, None] for v in lines)
    off = np.abs(nx * beams.x[near] + ny * beams.y[near] - d)
    cosine = nx * beams.dx[near] + ny * beams.dy[near]
    fits &= off <= np.maximum(0.5 * config.split_floor, config.split_sigmas * sigma * cosine)
    return np.asarray(fits)


def inner_lines(members: Members, laser: LaserConfig) -> tuple[Lines, Mask]:
    """Lines (K,) of the inner points, and which points (M,) at the ends they foretell.

    A point must lie within the noise of the sensor and of the inner points, and within what the
    latter alone foretell, so that on noiseless data nothing bent remains. Once a point is dropped,
    so are those beyond it.
    """
    starts, counts = members.starts, members.counts
    tail = np.clip((counts - 4) // 2, 0, TAIL)
    step = np.arange(TAIL)
    asked = step < tail[:, None]
    # The tails' points, (K, 2 TAIL): of the beginning and of the end, from the inside outwards.
    head = starts[:, None] + tail[:, None] - 1 - step
    foot = (starts + counts - tail)[:, None] + step
    asked = np.concatenate((asked, asked), axis=1)
    place = np.where(asked, np.concatenate((head, foot), axis=1), starts[:, None])
    x, y = members.x[place], members.y[place]
    sums = run_moments(members.x, members.y, starts) - few_moments(x, y, asked)
    lines = fit_moments(sums)

    n = sums[0]
    freedom = np.maximum(n - 2.0, 1.0)
    bound = STUDENT[np.clip(n.astype(np.int64) - 2, 1, len(STUDENT)) - 1] ** 2
    mx, my = sums[1] / n, sums[2] / n
    scatter = least_scatter(sums)
    extent = sums[3] + sums[5] - n * (mx * mx + my * my) - scatter
    nx, ny = lines.nx[:, None], lines.ny[:, None]
    residual = nx * x + ny * y - lines.d[:, None]
    s = nx * (y - my[:, None]) - ny * (x - mx[:, None])
    # The foretelling's own error grows with the distance from the inner points.
    lever = (1.0 + 1.0 / n)[:, None] + s * s / np.maximum(extent, 1e-9)[:, None]
    spread = np.maximum(scatter / freedom, 1e-12)
    sigma = laser.sigma_range + laser.sigma_range_scale * members.r[place]
    cosine = nx * members.ux[place] + ny * members.uy[place]
    limit = np.maximum((sigma * cosine) ** 2, spread[:, None]) * STUDENT[-1] ** 2
    np.minimum(limit, (bound * spread)[:, None], out=limit)
    bad = asked & (residual * residual > limit * lever)
    some = np.flatnonzero(bad.any(axis=1))
    foretold = np.ones(len(members.point), dtype=bool)
    for half in (slice(0, TAIL), slice(TAIL, 2 * TAIL)):
        drop = np.logical_or.accumulate(bad[some, half], axis=1) & asked[some, half]
        foretold[place[some, half][drop]] = False
    return lines, foretold
