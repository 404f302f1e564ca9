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
from hiermap_cli.perception.fitting import fit_moments, inner_moments, least_scatter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

SOLID = 3  # points that a run needs to take part
NEAR_BEAMS = 8  # neighbours with so few beams between may be joined along a line seen steeply
ALIKE = 0.8  # cosine between the normals of two pieces of one wall, at the least, but for those
SHORT = 0.3  # metres; that are too short to have one
ROUGH = 0.8  # standard deviation of a wall's points that is still believed, in `split_floor`
ACROSS = 3  # at most so many segments farther on is the other side of an occluder


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


class _Faces(NamedTuple):
    """What tells at a glance whether two segments may be one: all (K,).

    x0, y0, x1, y1: extreme points. extent: their squared distance. nx, ny: normal.
    """

    x0: Array
    y0: Array
    x1: Array
    y1: Array
    extent: Array
    nx: Array
    ny: Array

    def part(self, which: slice | Index) -> _Faces:
        """Those of the segments `which`."""
        return _Faces(*(v[which] for v in self))


class _State:
    """The segments while they are merged: arrays over all of them, changed in place.

    scan: of each segment. scatter, noise: of its fit, and of a point across it. into: the segment
    it was merged into, itself if none. Moments are kept by rows, (K, 6).
    """

    def __init__(self, beams: Beams, pieces: Pieces, laser: LaserConfig, uneven: float) -> None:
        self.beams, self.laser, self.uneven = beams, laser, uneven
        count = len(pieces.first)
        self.sums = np.ascontiguousarray(pieces.sums.T)
        self.first, self.last = pieces.first, pieces.last.copy()
        self.scan = beams.cell[pieces.first] // beams.ranges.shape[1]
        self.into = np.arange(count)
        self.scatter, self.noise = np.empty(count), np.empty(count)
        ends = (v.take(end) for end in (self.first, self.last) for v in (beams.x, beams.y))
        self.faces = _Faces(*ends, *(np.empty(count) for _ in range(3)))
        self.update(self.into)

    def update(self, k: Index) -> None:
        """Fit the segments k, and judge the noise of their points across the line.

        The noise is the larger of what the sensor has at that incidence and what the points show,
        as far as a wall may be uneven.
        """
        sums, last = self.sums.take(k, axis=0).T, self.last.take(k)
        line, scatter = fit_moments(sums)
        beams, laser = self.beams, self.laser
        faces, r = self.faces, beams.r.take(last)
        x, y = faces.x1.take(k), faces.y1.take(k)
        sigma = laser.sigma_range + laser.sigma_range_scale * r
        cosine = (line.nx * x + line.ny * y) / r
        shown = np.minimum(scatter / np.maximum(sums[0] - 2.0, 1.0), self.uneven)
        self.noise[k] = np.maximum((sigma * cosine) ** 2, shown)
        self.scatter[k] = scatter
        faces.nx[k], faces.ny[k] = line.nx, line.ny
        x -= faces.x0.take(k)
        y -= faces.y0.take(k)
        faces.extent[k] = x * x + y * y

    def join(self, i: Index, j: Index) -> None:
        """Merge each segment j into i; no segment may occur twice."""
        self.sums[i] += self.sums[j]
        for end in (self.last, self.faces.x1, self.faces.y1):
            end[i] = end[j]
        self.into[j] = i
        self.update(i)

    def alive(self, least: int) -> Index:
        """The segments that are not merged into others and have at least so many points."""
        whole = self.into == np.arange(len(self.into))
        return np.flatnonzero(whole & (self.sums[:, 0] >= least))


def merge(
    beams: Beams,
    breaks: Mask,
    runs: tuple[Index, Index],
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Pieces:
    """The segments of straight `runs`, which follow one another without a gap between.

    Segments of fewer than `min_points` are left out.
    """
    first, last = runs
    solid = np.flatnonzero(last - first + 1 >= SOLID)
    first, last = first.take(solid), last.take(solid)
    joined = _follow_on(beams, breaks, first, last)
    # Small runs without a neighbour are nobody's.
    beside = np.append(joined, False) | np.append(False, joined)
    kept = np.flatnonzero(beside | (last - first + 1 >= config.min_points))
    first, last = first.take(kept), last.take(kept)
    sums = inner_moments(beams.x, beams.y, first, last)
    pieces = Pieces(sums, first, last, first, last, np.arange(len(first)))
    if not len(first):
        return pieces
    state = _State(beams, pieces, laser, (ROUGH * config.split_floor) ** 2)
    _merge_neighbours(state, np.flatnonzero(np.append(joined, False)[kept]), config)
    _merge_across(state, config)
    if beams.cyclic:
        _merge_over_seam(state, config)
    into = _root(state.into, state.into)
    keep = (into == np.arange(len(into))) & (state.sums[:, 0] >= config.min_points)
    number = np.cumsum(keep) - 1
    kept = keep[into]
    return Pieces(
        state.sums[keep].T,
        state.first[keep],
        state.last[keep],
        first[kept],
        last[kept],
        number[into[kept]],
    )


def _follow_on(beams: Beams, breaks: Mask, first: Index, last: Index) -> Mask:
    """Whether each run (R,) is followed by the next one, (R - 1,): beam after beam.

    Beams that say nothing, and one or two points of neither, may lie between on one surface.
    """
    between = np.minimum(last[:-1] + np.arange(1, SOLID + 1)[:, None], first[1:])
    joined = (between[-1] == first[1:]) & ~breaks[between].any(axis=0)
    start, end = beams.cell[first[1:]], beams.cell[last[:-1]]
    width = beams.ranges.shape[1]
    return np.asarray(joined | ((start - end == 1) & (start // width == end // width)))


def _merge_neighbours(state: _State, joined: Index, config: SegmentationConfig) -> None:
    """Merge runs with those that follow on, until no line holds two; `joined` are followed so."""
    count = len(state.first)
    following, preceding = np.full(count, -1), np.full(count, -1)
    following[joined], preceding[joined + 1] = joined + 1, joined
    faces = state.faces
    likely = _likely(faces.part(slice(None, -1)), faces.part(slice(1, None)))
    i = joined[likely[joined]]
    while len(i):
        j = following[i]
        good, cost, _ = _one_line(state, i, j, config)
        waiting, j = i.take(good), j.take(good)
        chosen = np.flatnonzero(_without_conflicts(count, waiting, j, cost.take(good)))
        left, right = waiting.take(chosen), j.take(chosen)
        if not len(left):
            break
        state.join(left, right)
        after = following[right]
        following[left] = after
        preceding[after[after >= 0]] = left[after >= 0]
        # Only what has changed, or had to wait, is looked at again.
        again = np.zeros(count, dtype=bool)
        again[left] = again[preceding[left]] = again[waiting] = True
        again &= (following >= 0) & (state.into == np.arange(count))
        i = np.flatnonzero(again)
        i, _ = _likely_pairs(state, i, following[i])


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


def _merge_across(state: _State, config: SegmentationConfig) -> None:
    """Merge each segment with one of the next few, where both are one wall.

    Between them are small pieces, or something that stands before the wall.
    """
    alive = state.alive(config.min_points)
    faces = state.faces.part(alive)
    scan, first, last = state.scan[alive], state.first[alive], state.last[alive]
    pairs = []
    # Each with the one so many places farther on, by slices: what is known of them is looked up
    # once a segment, not once a pair.
    for k in range(1, ACROSS + 1):
        likely = _likely(faces.part(slice(None, -k)), faces.part(slice(k, None)))
        likely &= (scan[:-k] == scan[k:]) & (last[:-k] + 1 < first[k:])
        at = np.flatnonzero(likely)
        pairs.append(alive[np.stack((at, at + k))])
    i, j = np.concatenate(pairs, axis=1)
    good, cost = _mergeable(state, i, j, config)
    i, j = i[good], j[good]
    while len(i):
        chosen = _without_conflicts(len(state.first), i, j, cost[good])
        if not chosen.any():
            break
        state.join(i[chosen], j[chosen])
        # What was merged on may be merged again, with what comes after.
        i, j = _root(state.into, i[~chosen]), j[~chosen]
        some = (state.into[j] == j) & (state.last[i] < state.first[j])
        i, j = _likely_pairs(state, i[some], j[some])
        good, cost = _mergeable(state, i, j, config)
        i, j = i[good], j[good]


def _merge_over_seam(state: _State, config: SegmentationConfig) -> None:
    """Merge the last segment of each full circle with its first, where both are one wall."""
    alive = state.alive(config.min_points)
    opening = np.flatnonzero(np.diff(state.scan[alive], prepend=-1))
    closing = np.append(opening[1:], len(alive)) - 1
    several = closing > opening
    opening, closing = alive[opening[several]], alive[closing[several]]
    closing, opening = _likely_pairs(state, closing, opening)
    good, _ = _mergeable(state, closing, opening, config)
    state.join(closing[good], opening[good])


def _root(into: Index, k: Index) -> Index:
    """The segments that the segments k were merged into in the end."""
    while not np.array_equal(k, above := into.take(k)):
        k = above
    return k


def _square_gap(beams: Beams, last: Index, first: Index) -> Array:
    """Squared distance between two points."""
    x, y = beams.x.take(first), beams.y.take(first)
    x -= beams.x.take(last)
    y -= beams.y.take(last)
    return x * x + y * y


def _mergeable(
    state: _State, i: Index, j: Index, config: SegmentationConfig
) -> tuple[Index, Array]:
    """Which of the likely pairs one line holds and nothing between denies it; and all costs."""
    good, cost, sums = _one_line(state, i, j, config)
    last, first = state.last.take(i.take(good)), state.first.take(j.take(good))
    return good[_gap_allows(state, last, first, sums, config)], cost


def _likely(a: _Faces, b: _Faces) -> Mask:
    """Whether segments a and b may be one wall: (K,).

    Two small heaps far apart are no line, although one always goes through both; and what is
    long enough to have a direction must share it.
    """
    x, y = b.x0 - a.x1, b.y0 - a.y1
    likely = x * x + y * y <= np.maximum(a.extent, b.extent)
    likely &= (a.nx * b.nx + a.ny * b.ny > ALIKE) | (np.minimum(a.extent, b.extent) < SHORT**2)
    return np.asarray(likely)


def _likely_pairs(state: _State, i: Index, j: Index) -> tuple[Index, Index]:
    """Those of the pairs of segments i and j that may be one wall."""
    likely = np.flatnonzero(_likely(state.faces.part(i), state.faces.part(j)))
    return i.take(likely), j.take(likely)


def _one_line(
    state: _State, i: Index, j: Index, config: SegmentationConfig
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
