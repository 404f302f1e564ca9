"""Which points belong to which line: boundaries at corners, tails that bend away, outliers.

A point at a corner given to the wrong wall bends its line by far more than noise does; here the
boundary between two neighbours goes where both lines explain their points best, and points at the
ends of a segment that its own inner points do not foretell are dropped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.perception.fitting import fit_moments, moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.perception.beams import Beams
    from hiermap_cli.perception.splitting import Pieces

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

WINDOW = 4  # points on each side of a boundary that may change sides
LOOSE = 3  # points of no segment between two neighbours that are shared out
TAIL = 4  # points at each end that must be foretold by the others

# Two-sided 99.9 % quantiles of Student's t for 1, 2, .. 20 degrees of freedom, then the normal.
STUDENT = np.array(
    (
        *(636.6, 31.6, 12.92, 8.61, 6.87, 5.96, 5.41, 5.04, 4.78, 4.59),
        *(4.44, 4.32, 4.22, 4.14, 4.07, 4.01, 3.97, 3.92, 3.88, 3.85),
        3.29,
    )
)


def student_bound(freedom: Array) -> Array:
    """The 99.9 % bound of |t| at `freedom` degrees of freedom (inf below 1)."""
    freedom = np.asarray(freedom, dtype=np.int64)
    bound = STUDENT[np.clip(freedom, 1, len(STUDENT)) - 1]
    return np.where(freedom < 1, np.inf, bound)


def place_boundaries(
    beams: Beams, sums: Array, values: Array, breaks: Mask, pieces: Pieces
) -> tuple[Index, Index]:
    """New first and last points of the runs, (R,), (R,), where neighbours meet at a corner.

    Of every cut in the window around the old one the cut with the least sum of squared residuals
    is taken; the lines for it are fitted without the points of the window's middle.
    """
    first, last = pieces.run_first.copy(), pieces.run_last.copy()
    order = np.argsort(first, kind="stable")
    left, right = order[:-1], order[1:]
    surface = np.cumsum(breaks)
    meets = (
        (first[right] - last[left] - 1 <= LOOSE)
        & (surface[first[right]] == surface[last[left]])
        & (pieces.run_segment[left] != pieces.run_segment[right])
    )
    left, right = left[meets], right[meets]
    if not len(left):
        return first, last
    for _ in range(2):
        lines = []
        for runs in (left, right):
            inner = np.minimum(2, (last[runs] - first[runs] - 2) // 2)
            inner = np.maximum(inner, 0)
            a = first[runs] + np.where(runs is right, inner, 0)
            b = last[runs] - np.where(runs is left, inner, 0)
            whole = pieces.sums[:, pieces.run_segment[runs]]
            outer = moments(sums, values, pieces.run_first[runs], pieces.run_last[runs])
            own = whole - outer + moments(sums, values, a, b)
            lines.append(fit_moments(own))
        lo = np.maximum(first[left] + 1, last[left] - WINDOW + 1)
        hi = np.minimum(last[right] - 1, first[right] + WINDOW - 1)
        size = 2 * WINDOW + LOOSE
        grid = lo[:, None] + np.arange(size)
        inside = grid <= hi[:, None]
        point = np.minimum(grid, hi[:, None])
        x, y = beams.x[point], beams.y[point]
        cost = []
        for line in lines:
            e = line.nx[:, None] * x + line.ny[:, None] * y - line.d[:, None]
            cost.append(np.where(inside, e * e, 0.0))
        # Cut k gives the first k points of the window to the left.
        total = np.zeros((len(left), size + 1))
        total[:, 1:] += np.cumsum(cost[0], axis=1)
        total[:, :-1] += np.cumsum(cost[1][:, ::-1], axis=1)[:, ::-1]
        allowed = np.arange(size + 1)[None, :] <= (hi - lo + 1)[:, None]
        cut = np.argmin(np.where(allowed, total, np.inf), axis=1)
        last[left] = lo + cut - 1
        first[right] = lo + cut
    return first, last


def tails_to_drop(index: Index, starts: Index, residual: Array, cosine: Array, s: Array) -> Mask:
    """False for points (M,) at the ends of segments that the inner points do not foretell.

    Args:
        index: (M,) points, segment after segment, each in order.
        starts: (K,) where the segments begin.
        residual: (M,) perpendicular residuals of lines fitted to the inner points.
        cosine: (M,) of the incidence: the residual's noise is proportional to it.
        s: (M,) position along the line.
    """
    counts = np.diff(starts, append=len(index))
    tail = tail_lengths(counts)
    scaled = residual / cosine
    position = np.arange(len(index)) - np.repeat(starts, counts)
    t = np.repeat(tail, counts)
    n = np.repeat(counts, counts)
    core = (position >= t) & (position < n - t)
    square = np.add.reduceat(np.where(core, scaled * scaled, 0.0), starts)
    freedom = counts - 2 * tail - 2
    spread = np.sqrt(square / np.maximum(freedom, 1))
    # How far the tail is extrapolated, in units of the core's own extent.
    inner = np.maximum(counts - 2 * tail, 1)
    mean = np.add.reduceat(np.where(core, s, 0.0), starts) / inner
    off = s - np.repeat(mean, counts)
    extent = np.add.reduceat(np.where(core, off * off, 0.0), starts)
    lever = np.repeat(1.0 + 1.0 / inner, counts) + off * off / np.repeat(
        np.maximum(extent, 1e-12), counts
    )
    bound = np.repeat(student_bound(freedom) * np.maximum(spread, 1e-6), counts) * np.sqrt(lever)
    bad = (np.abs(scaled) > bound) & ~core
    keep = np.ones(len(index), dtype=bool)
    hits = np.flatnonzero(bad)
    if not len(hits):
        return keep
    segment = np.repeat(np.arange(len(starts)), counts)[hits]
    ahead = position[hits] < t[hits]
    low = np.zeros(len(starts), dtype=np.int64)
    high = counts.copy()
    np.maximum.at(low, segment[ahead], position[hits][ahead] + 1)
    np.minimum.at(high, segment[~ahead], position[hits][~ahead])
    return (position >= np.repeat(low, counts)) & (position < np.repeat(high, counts))


def tail_lengths(counts: Index) -> Index:
    """How many points at each end of segments of `counts` points are tested by the others."""
    return np.clip((counts - 4) // 2, 0, TAIL)


def core_mask(starts: Index, counts: Index) -> Mask:
    """True for the points (M,) that are not in a tail."""
    position = np.arange(int(counts.sum())) - np.repeat(starts, counts)
    t = np.repeat(tail_lengths(counts), counts)
    return (position >= t) & (position < np.repeat(counts, counts) - t)
