"""Merging straight runs of one line into segments, many scans at once.

Merges compare fits, not points, so that each costs O(1): two pieces are one where the ends of both
fitted lines lie on the common one. Neighbours come first; then pieces that are the same wall on
both sides of something that stands before it. A door gap is never closed: what lies behind the
line there is farther.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.perception.fitting import inner_moments
from hiermap_cli.perception.one_wall import likely, likely_pairs, mergeable, one_line
from hiermap_cli.perception.pieces import Merging, Pieces

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

SOLID = 3  # points that a run needs to take part
ROUGH = 0.8  # standard deviation of a wall's points that is still believed, in `split_floor`
ACROSS = 3  # at most so many segments farther on is the other side of an occluder


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
    state = Merging(beams, pieces, laser, (ROUGH * config.split_floor) ** 2)
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


def _merge_neighbours(state: Merging, joined: Index, config: SegmentationConfig) -> None:
    """Merge runs with those that follow on, until no line holds two; `joined` are followed so."""
    count = len(state.first)
    following, preceding = np.full(count, -1), np.full(count, -1)
    following[joined], preceding[joined + 1] = joined + 1, joined
    faces = state.faces
    maybe = likely(faces.part(slice(None, -1)), faces.part(slice(1, None)))
    i = joined[maybe[joined]]
    while len(i):
        j = following[i]
        good, cost, _ = one_line(state, i, j, config)
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
        i, _ = likely_pairs(state, i, following[i])


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


def _merge_across(state: Merging, config: SegmentationConfig) -> None:
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
        maybe = likely(faces.part(slice(None, -k)), faces.part(slice(k, None)))
        maybe &= (scan[:-k] == scan[k:]) & (last[:-k] + 1 < first[k:])
        at = np.flatnonzero(maybe)
        pairs.append(alive[np.stack((at, at + k))])
    i, j = np.concatenate(pairs, axis=1)
    good, cost = mergeable(state, i, j, config)
    i, j = i[good], j[good]
    while len(i):
        chosen = _without_conflicts(len(state.first), i, j, cost[good])
        if not chosen.any():
            break
        state.join(i[chosen], j[chosen])
        # What was merged on may be merged again, with what comes after.
        i, j = _root(state.into, i[~chosen]), j[~chosen]
        some = (state.into[j] == j) & (state.last[i] < state.first[j])
        i, j = likely_pairs(state, i[some], j[some])
        good, cost = mergeable(state, i, j, config)
        i, j = i[good], j[good]


def _merge_over_seam(state: Merging, config: SegmentationConfig) -> None:
    """Merge the last segment of each full circle with its first, where both are one wall."""
    alive = state.alive(config.min_points)
    opening = np.flatnonzero(np.diff(state.scan[alive], prepend=-1))
    closing = np.append(opening[1:], len(alive)) - 1
    several = closing > opening
    opening, closing = alive[opening[several]], alive[closing[several]]
    closing, opening = likely_pairs(state, closing, opening)
    good, _ = mergeable(state, closing, opening, config)
    state.join(closing[good], opening[good])


def _root(into: Index, k: Index) -> Index:
    """The segments that the segments k were merged into in the end."""
    while not np.array_equal(k, above := into.take(k)):
        k = above
    return k
