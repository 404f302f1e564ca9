"""Which points belong to which line: boundaries at corners, points gained beyond, tails dropped.

A point at a corner given to the wrong wall bends its line by far more than noise does. Here the
boundary between two neighbours goes where both lines explain their points best, single points
beyond a jump join the line that foretells them, and points at the ends of a segment that its own
inner points do not foretell are dropped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.perception.beams import concatenated_ranges
from hiermap_cli.perception.fitting import (
    few_moments,
    fit_moments,
    least_scatter,
    run_moments,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams
    from hiermap_cli.perception.fitting import Lines, Members
    from hiermap_cli.perception.merging import Pieces

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

WINDOW = 4  # points on each side of a boundary that may change sides
LOOSE = 3  # points of no segment between two neighbours that are shared out
UNSURE = 2  # points on each side of a boundary that do not help to place it
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


def place_boundaries(beams: Beams, breaks: Mask, pieces: Pieces) -> tuple[Index, Index]:
    """New first and last points of the runs, (R,), (R,), where neighbours meet at a corner.

    Of every cut in the window around the old one, that with the least sum of squared residuals is
    taken; the lines for it are fitted without the points next to the old cut.
    """
    first, last = pieces.run_first.copy(), pieces.run_last.copy()
    owner = pieces.run_segment
    left = np.flatnonzero((first[1:] - last[:-1] - 1 <= LOOSE) & (owner[1:] != owner[:-1]))
    surface = np.cumsum(breaks)
    left = left[surface[first[left + 1]] == surface[last[left]]]
    if not len(left):
        return first, last
    right = left + 1
    runs = np.concatenate((left, right))
    inwards = np.repeat((-1, 1), len(left))
    edge = np.concatenate((last[left], first[right]))
    unsure = np.clip((last[runs] - first[runs] - 2) // 2, 0, UNSURE)
    step = np.arange(UNSURE)
    point = edge[:, None] + inwards[:, None] * np.minimum(step, np.maximum(unsure - 1, 0)[:, None])
    dropped = few_moments(beams.x[point], beams.y[point], step < unsure[:, None])
    lines = fit_moments(pieces.sums[:, owner[runs]] - dropped)

    size = 2 * WINDOW + LOOSE
    lo = np.maximum(first[left] + 1, last[left] - WINDOW + 1)
    hi = np.minimum(last[right] - 1, first[right] + WINDOW - 1)
    grid = lo[:, None] + np.arange(size)
    point = np.minimum(grid, hi[:, None])
    cost = _square_residuals(beams, lines, np.concatenate((point, point)))
    cost *= np.tile(grid <= hi[:, None], (2, 1))
    # Cut k gives the first k points of the window to the left.
    total = np.zeros((len(left), size + 1))
    np.cumsum(cost[: len(left)], axis=1, out=total[:, 1:])
    total[:, :-1] += np.cumsum(cost[len(left) :, ::-1], axis=1)[:, ::-1]
    total[np.arange(size + 1)[None, :] > (hi - lo + 1)[:, None]] = np.inf
    cut = np.argmin(total, axis=1)
    last[left] = lo + cut - 1
    first[right] = lo + cut
    return first, last


def _square_residuals(beams: Beams, lines: Lines, point: Index) -> Array:
    """Squared distances of points (K, m) from the lines (K,)."""
    e = lines.nx[:, None] * beams.x[point] + lines.ny[:, None] * beams.y[point]
    e -= lines.d[:, None]
    e *= e
    return e


def gain_points(
    beams: Beams,
    breaks: Mask,
    lines: Lines,
    runs: tuple[Index, Index, Index],
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
        runs: first and last points and segments of the runs, (R,) each, in order.
        laser: noise of ranges.
        config: how uneven a wall may be.
    """
    first, last, _ = runs
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
    cosine = lines.nx[:, None] * beams.dx[near] + lines.ny[:, None] * beams.dy[near]
    allowed = np.maximum(0.5 * config.split_floor, config.split_sigmas * sigma * cosine)
    fits &= _square_residuals(beams, lines, near) <= allowed * allowed
    return np.asarray(fits)


def inner_lines(members: Members) -> tuple[Lines, Mask]:
    """Lines (K,) of the inner points, and which points (M,) at the ends they foretell.

    The inner points' own scatter is the measure, whatever the sensor's noise is said to be, so
    that on noiseless data nothing bent remains. Once a point is dropped, so are those beyond it.
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
    limit = bound * np.maximum(scatter / freedom, 1e-12)
    bad = asked & (residual * residual > limit[:, None] * lever)
    some = np.flatnonzero(bad.any(axis=1))
    foretold = np.ones(len(members.point), dtype=bool)
    for half in (slice(0, TAIL), slice(TAIL, 2 * TAIL)):
        drop = np.logical_or.accumulate(bad[some, half], axis=1) & asked[some, half]
        foretold[place[some, half][drop]] = False
    return lines, foretold
