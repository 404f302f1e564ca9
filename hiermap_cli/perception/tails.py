"""The ends of segments: points gained beyond them, tails that the inner points do not foretell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.perception.fitting import few_moments, fit_moments, run_moments

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
    low, high = first.copy(), last.copy()
    before, after = np.append(-1, last[:-1]), np.append(first[1:], len(beams.cell))
    for end, out, step, room in (
        (first, low, -1, first - before - 1),  # how many points are of no run, on that side
        (last, high, 1, after - last - 1),
    ):
        some = np.flatnonzero(room > 0)
        # Points of the same surface were split off on purpose.
        some = some[breaks.take(end.take(some) + (step > 0))]
        fits = _on_line(beams, lines.take(some), end[some], step, 1, laser, config)
        some = some[fits[0]]
        line, at = lines.take(some), end[some]
        fits = _on_line(beams, line, at, step, GAIN, laser, config)
        fits &= np.arange(1, GAIN + 1)[:, None] <= room[some]
        out[some] += step * np.logical_and.accumulate(fits, axis=0).sum(axis=0)
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
    """Which of the `many` next points (many, K) of ends (K,) follow on the lines without a gap."""
    total, width = len(beams.cell), beams.ranges.shape[1]
    point = np.clip(end + step * np.arange(many + 1)[:, None], 0, total - 1)
    near, cell = point[1:], beams.cell[point]
    between = np.abs(cell[1:] - cell[:-1]) - 1
    fits = (between >= 0) & (between <= config.max_gap_beams)
    fits &= cell[1:] // width == cell[0] // width
    r = beams.r.take(near)
    sigma = laser.sigma_range + laser.sigma_range_scale * r
    nx, ny, d = lines
    depth = nx * beams.x.take(near) + ny * beams.y.take(near)
    noise = config.split_sigmas * sigma * depth / r
    fits &= np.abs(depth - d) <= np.maximum(0.5 * config.split_floor, noise)
    return np.asarray(fits)


def inner_lines(members: Members, laser: LaserConfig) -> tuple[Lines, Index]:
    """Lines (K,) of the inner points, and how many points they do not foretell at each end (K, 2).

    A point must lie within the noise of the sensor and of the inner points, and within what the
    latter alone foretell, so that on noiseless data nothing bent remains. Once a point is dropped,
    so are those beyond it.
    """
    starts, counts = members.starts, members.counts
    tail = np.clip((counts - 4) // 2, 0, TAIL)
    step = np.arange(TAIL)[:, None]
    # The tails' points, (2 TAIL, K): of the beginning and of the end, from the inside outwards.
    asked = np.concatenate((step < tail, step < tail))
    place = np.concatenate((starts + tail - 1 - step, starts + counts - tail + step))
    place = np.where(asked, place, starts)
    ux, uy, r = members.ux.take(place), members.uy.take(place), members.r.take(place)
    x, y = r * ux, r * uy
    # All points without the tails': half as many runs to sum as tails and inner points apart.
    sums = run_moments(members.r * members.ux, members.r * members.uy, starts)
    sums -= few_moments(x, y, asked)
    lines, scatter = fit_moments(sums)
    n = sums[0]
    mx, my = sums[1] / n, sums[2] / n
    extent = sums[3] + sums[5] - n * (mx * mx + my * my) - scatter
    nx, ny, d = lines
    residual = nx * x + ny * y - d
    s = nx * (y - my) - ny * (x - mx)
    # The foretelling's own error grows with the distance from the inner points.
    lever = s * s / np.maximum(extent, 1e-9) + (1.0 + 1.0 / n)
    spread = np.maximum(scatter / np.maximum(n - 2.0, 1.0), 1e-12)
    bound = STUDENT[np.clip(n.astype(np.int64) - 2, 1, len(STUDENT)) - 1]
    sigma = laser.sigma_range + laser.sigma_range_scale * r
    cosine = nx * ux + ny * uy
    limit = np.maximum((sigma * cosine) ** 2, spread) * STUDENT[-1] ** 2
    np.minimum(limit, bound * bound * spread, out=limit)
    bad = asked & (residual * residual > limit * lever)
    # From the first that is bad on, all that were asked.
    dropped = [
        np.where(half.any(axis=0), tail - np.argmax(half, axis=0), 0)
        for half in (bad[:TAIL], bad[TAIL:])
    ]
    return lines, np.stack(dropped, axis=1)
