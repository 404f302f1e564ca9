"""Whether two pieces of one scan are one wall: asked of the fits, not of the points.

First what tells at a glance, then what a common line costs, last what is seen between them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.perception.beams import concatenated_ranges
from hiermap_cli.perception.fitting import fit_moments, least_scatter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import SegmentationConfig
    from hiermap_cli.perception.beams import Beams
    from hiermap_cli.perception.pieces import Faces, Merging

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

NEAR_BEAMS = 8  # neighbours with so few beams between may be joined along a line seen steeply
ALIKE = 0.8  # cosine between the normals of two pieces of one wall, at the least, but for those
SHORT = 0.3  # metres; that are too short to have one


def likely(a: Faces, b: Faces) -> Mask:
    """Whether segments a and b may be one wall: (K,).

    Two small heaps far apart are no line, although one always goes through both; and what is
    long enough to have a direction must share it.
    """
    x, y = b.x0 - a.x1, b.y0 - a.y1
    maybe = x * x + y * y <= np.maximum(a.extent, b.extent)
    maybe &= (a.nx * b.nx + a.ny * b.ny > ALIKE) | (np.minimum(a.extent, b.extent) < SHORT**2)
    return np.asarray(maybe)


def likely_pairs(state: Merging, i: Index, j: Index) -> tuple[Index, Index]:
    """Those of the pairs of segments i and j that may be one wall."""
    maybe = np.flatnonzero(likely(state.faces.part(i), state.faces.part(j)))
    return i.take(maybe), j.take(maybe)


def one_line(
    state: Merging, i: Index, j: Index, config: SegmentationConfig
) -> tuple[Index, Array, Array]:
    """Which of the likely pairs one line holds, all costs, and the moments of those it does.

    What a common line costs, the growth of the scatter, is the noise's variance times a chi-square
    of two degrees of freedom when both are one line, or a little more as runs are split where they
    deviate most (hence one sigma more). Walls are uneven: the smaller piece may turn off the line
    by half of `split_floor` at its end, which is a third of that squared a point; but all points
    together must still make a line.
    """
    both = (state.sums.take(i, axis=0) + state.sums.take(j, axis=0)).T
    n_i = state.sums[:, 0].take(i)
    n_j = both[0] - n_i
    scatter = least_scatter(both)
    noise = (n_i * state.noise.take(i) + n_j * state.noise.take(j)) / both[0]
    bends = (
        np.minimum(n_i, n_j) * (config.split_floor**2 / 12.0)
        + (config.split_sigmas + 1.0) ** 2 * noise
    )
    price = (scatter - state.scatter.take(i) - state.scatter.take(j)) / bends
    freedom = both[0] - 2.0
    most = freedom + config.split_sigmas * np.sqrt(2.0 * freedom)
    good = np.flatnonzero((price < 1.0) & (scatter < most * (state.uneven + noise)))
    return good, price, both.take(good, axis=1)


def mergeable(
    state: Merging, i: Index, j: Index, config: SegmentationConfig
) -> tuple[Index, Array]:
    """Which of the likely pairs one line holds and nothing between denies it; and all costs."""
    good, cost, sums = one_line(state, i, j, config)
    last, first = state.last.take(i.take(good)), state.first.take(j.take(good))
    return good[_gap_allows(state, last, first, sums, config)], cost


def _gap_allows(
    state: Merging, last: Index, first: Index, sums: Array, config: SegmentationConfig
) -> Mask:
    """Whether nothing between two pieces of common moments shows that the wall is missing there.

    Beams between must say nothing, end on the line, or before it; where the pieces are near, one
    beam alone may go farther. Where they are not, at most one beam may not end on the line.
    """
    beams, laser = state.beams, state.laser
    width = beams.ranges.shape[1]
    between = beams.cell[first] - beams.cell[last] - 1
    between = np.where(between < 0, between + width, between)  # over the seam
    ok = np.ones(len(first), dtype=bool)
    apart = np.flatnonzero(between > 0)
    if not len(apart):
        return ok
    near = _square_gap(beams, last[apart], first[apart]) <= config.merge_gap**2
    ok[apart] = near | (between[apart] <= NEAR_BEAMS)
    apart, near = apart[ok[apart]], near[ok[apart]]
    if not len(apart):
        return ok
    line, _ = fit_moments(sums[:, apart])
    count = between[apart]
    after = concatenated_ranges(np.ones(len(apart), dtype=np.int64), count)
    row, column = np.divmod(np.repeat(beams.cell[last[apart]], count), width)
    cells = row * width + (column + after) % width
    starts = np.cumsum(count) - count
    nx, ny, d = (np.repeat(v, count) for v in line)
    beam = beams.beam(cells)
    cosine = nx * beams.ux[beam] + ny * beams.uy[beam]
    r = beams.ranges.ravel()[cells]
    sigma = laser.sigma_range + laser.sigma_range_scale * np.where(np.isfinite(r), r, 0.0)
    tolerance = np.maximum(config.split_floor, config.split_sigmas * sigma * cosine)
    with np.errstate(invalid="ignore"):
        off = r * cosine - d
        far = (off > tolerance) & (cosine > 0.0)
        off_line = ~(np.abs(off) <= tolerance)
    farther = np.add.reduceat(far.astype(np.int64), starts)
    unlike = np.add.reduceat(off_line.astype(np.int64), starts)
    ok[apart] = (farther <= near) & (near | (unlike <= 1))
    return ok


def _square_gap(beams: Beams, last: Index, first: Index) -> Array:
    """Squared distance between two points."""
    x, y = beams.x.take(first), beams.y.take(first)
    x -= beams.x.take(last)
    y -= beams.y.take(last)
    return x * x + y * y
