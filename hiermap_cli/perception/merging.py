"""Merging straight runs of one line into segments, many scans at once.

Merges compare fits, not points, so that each costs O(1): two pieces are one where the ends of both
fitted lines lie on the common one. Neighbours come first; then pieces that are the same wall on
both sides of something that stands before it. A door gap is never closed: what lies behind the
line there is farther.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.perception.beams import concatenated_ranges
from hiermap_cli.perception.fitting import fit_moments, least_scatter, run_moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

SOLID = 3  # points that a run needs to take part
NEAR_BEAMS = 8  # neighbours with so few beams between may be joined along a line seen steeply
ALIKE = 0.9  # cosine between the normals of two sides of one wall, at the least
ACROSS = 4  # at most so many segments farther on is the other side of an occluder


class Pieces(NamedTuple):
    """Segments as merged runs: K segments in the order of their first points.

    sums: (6, K) moments. first, last: (K,) extreme points; of a wall across the seam of a full
    circle the first point comes after the last. run_first, run_last: (R,) the points of the runs
    that make up the segments, run_segment: (R,) whose they are; runs in order of their points.
    """

    sums: Array
    first: Index
    last: Index
    run_first: Index
    run_last: Index
    run_segment: Index


class _State:
    """The segments while they are merged: arrays over all of them, changed in place."""

    def __init__(self, beams: Beams, pieces: Pieces, laser: LaserConfig, uneven: float) -> None:
        self.beams, self.laser, self.uneven = beams, laser, uneven
        self.sums, self.first, self.last = pieces.sums, pieces.first.copy(), pieces.last.copy()
        self.scan = beams.cell[pieces.first] // beams.ranges.shape[1]
        self.scatter = np.empty(len(self.first))
        self.noise = np.empty(len(self.first))
        self.normal = np.empty((2, len(self.first)))
        self.into = np.arange(len(self.first))
        self.update(self.into)

    def update(self, k: Index) -> None:
        """Scatter of the segments k, their normals, and the noise of their points across them.

        The noise is the larger of what the sensor has at that incidence and what the points show,
        as far as a wall may be uneven.
        """
        sums = self.sums[:, k]
        scatter, line, point = least_scatter(sums), fit_moments(sums), self.last[k]
        sigma = self.laser.sigma_range + self.laser.sigma_range_scale * self.beams.r[point]
        cosine = line.nx * self.beams.dx[point] + line.ny * self.beams.dy[point]
        shown = np.minimum(scatter / np.maximum(sums[0] - 2.0, 1.0), self.uneven)
        self.noise[k] = np.maximum((sigma * cosine) ** 2, shown)
        self.scatter[k], self.normal[:, k] = scatter, (line.nx, line.ny)

    def extent(self, k: Index) -> Array:
        """Squared distances between the extreme points of the segments k."""
        return _square_gap(self.beams, self.first[k], self.last[k])

    def join(self, i: Index, j: Index) -> None:
        """Merge each segment j into i; no segment may occur twice."""
        self.sums[:, i] += self.sums[:, j]
        self.last[i] = self.last[j]
        self.into[j] = i
        self.update(i)

    def alive(self, least: int) -> Index:
        """The segments that are not merged into others and have at least so many points."""
        whole = self.into == np.arange(len(self.into))
        return np.flatnonzero(whole & (self.sums[0] >= least))


def merge(
    beams: Beams,
    runs: tuple[Index, Index],
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Pieces:
    """The segments of straight `runs`, which follow one another without a gap between.

    Segments of fewer than `min_points` are left out.
    """
    first, last = runs
    sums = run_moments(beams.x, beams.y, first)
    solid = np.flatnonzero(last - first + 1 >= SOLID)
    first, last = first[solid], last[solid]
    pieces = Pieces(sums[:, solid], first, last, first, last, np.arange(len(first)))
    if not len(first):
        return pieces
    state = _State(beams, pieces, laser, (0.5 * config.split_floor) ** 2)
    tried = _merge_neighbours(state, config)
    for offset in range(1, ACROSS + 1):
        _merge_across(state, offset, tried, config)
    if beams.cyclic:
        _merge_over_seam(state, config)
    into = state.into
    while not np.array_equal(into, into[into]):
        into = into[into]
    keep = (into == np.arange(len(into))) & (state.sums[0] >= config.min_points)
    number = np.cumsum(keep) - 1
    kept = keep[into]
    return Pieces(
        state.sums[:, keep],
        state.first[keep],
        state.last[keep],
        first[kept],
        last[kept],
        number[into[kept]],
    )


def _merge_neighbours(state: _State, config: SegmentationConfig) -> Index:
    """Merge neighbours until none is left that one line holds; each one's next (K,), -1 if none."""
    count = len(state.first)
    joined = state.scan[1:] == state.scan[:-1]
    following = np.append(np.where(joined, np.arange(1, count), -1), -1)
    preceding = np.append(-1, np.where(joined, np.arange(count - 1), -1))
    i = np.flatnonzero(following >= 0)
    while len(i):
        j = following[i]
        good, cost = _mergeable(state, i, j, config)
        waiting, j = i[good], j[good]
        chosen = _without_conflicts(count, waiting, j, cost[good])
        left, right = waiting[chosen], j[chosen]
        state.join(left, right)
        after = following[right]
        following[left] = after
        preceding[after[after >= 0]] = left[after >= 0]
        # Only what has changed, or had to wait, is looked at again.
        again = np.concatenate((left, preceding[left], waiting[~chosen]))
        again = np.unique(again[again >= 0])
        i = again[(state.into[again] == again) & (following[again] >= 0)]
        if not len(left):
            break
    return following


def _without_conflicts(count: int, i: Index, j: Index, cost: Array) -> Mask:
    """Of pairs that share a segment only the cheapest; equal ones from the left."""
    best = np.full(count, np.inf)
    np.minimum.at(best, i, cost)
    np.minimum.at(best, j, cost)
    chosen = (cost <= best[i]) & (cost <= best[j])
    taken = np.zeros(count, dtype=bool)
    taken[j[chosen]] = True
    chosen &= ~taken[i]
    return np.asarray(chosen)


def _merge_across(state: _State, offset: int, tried: Index, config: SegmentationConfig) -> None:
    """Merge each segment with the one `offset` farther on, where both are one wall.

    `tried` (K,) names each segment's neighbour, with which one line does not hold it.
    """
    alive = state.alive(config.min_points)
    i, j = alive[:-offset], alive[offset:]
    reach = config.merge_gap**2
    open_ = (state.scan[i] == state.scan[j]) & (state.last[i] < state.first[j]) & (tried[i] != j)
    open_ &= _square_gap(state.beams, state.last[i], state.first[j]) <= reach
    i, j = i[open_], j[open_]
    alike = (state.normal[:, i] * state.normal[:, j]).sum(axis=0) > ALIKE
    i, j = i[alike], j[alike]
    good, cost = _mergeable(state, i, j, config)
    i, j = i[good], j[good]
    chosen = _without_conflicts(len(state.first), i, j, cost[good])
    state.join(i[chosen], j[chosen])


def _merge_over_seam(state: _State, config: SegmentationConfig) -> None:
    """Merge the last segment of each full circle with its first, where both are one wall."""
    alive = state.alive(config.min_points)
    opening = np.flatnonzero(np.diff(state.scan[alive], prepend=-1))
    closing = np.append(opening[1:], len(alive)) - 1
    several = closing > opening
    opening, closing = alive[opening[several]], alive[closing[several]]
    good, _ = _mergeable(state, closing, opening, config)
    state.join(closing[good], opening[good])


def _square_gap(beams: Beams, last: Index, first: Index) -> Array:
    """Squared distance between two points."""
    return np.asarray((beams.x[first] - beams.x[last]) ** 2 + (beams.y[first] - beams.y[last]) ** 2)


def _mergeable(state: _State, i: Index, j: Index, config: SegmentationConfig) -> tuple[Mask, Array]:
    """Whether one line holds segments i and j, and nothing between denies it; and the cost.

    What a common line costs, the growth of the scatter, is the noise's variance times a chi-square
    of two degrees of freedom when both are one line, or a little more as runs are split where they
    deviate most (hence one sigma more). Walls are uneven: the smaller piece may turn
    off the line by half of `split_floor` at its end, which is a third of that squared a point;
    but all points together must still make a line.
    """
    both = state.sums[:, i] + state.sums[:, j]
    n_i, n_j = state.sums[0, i], state.sums[0, j]
    n = n_i + n_j
    scatter = least_scatter(both)
    noise = (n_i * state.noise[i] + n_j * state.noise[j]) / n
    bends = np.minimum(n_i, n_j) * (state.uneven / 3.0) + (config.split_sigmas + 1.0) ** 2 * noise
    cost = (scatter - state.scatter[i] - state.scatter[j]) / bends
    freedom = n - 2.0
    most = freedom + config.split_sigmas * np.sqrt(2.0 * freedom)
    good = (cost < 1.0) & (scatter < most * (state.uneven + noise))
    # Two small heaps far apart are no line, although one always goes through both.
    gap = _square_gap(state.beams, state.last[i], state.first[j])
    good &= gap <= np.maximum(state.extent(i), state.extent(j))
    some = np.flatnonzero(good)
    last, first = state.last[i[some]], state.first[j[some]]
    good[some] = _gap_allows(state, last, first, both[:, some], config)
    return good, cost


def _gap_allows(
    state: _State, last: Index, first: Index, sums: Array, config: SegmentationConfig
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
    line, count = fit_moments(sums[:, apart]), between[apart]
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
