"""Split and merge over all scans of a block at once, level by level.

A run of points is split at the point farthest from its chord while it bends; the pieces are then
merged where one line holds both. Splits are made level by level over every run of the block with
`ufunc.reduceat`; merges compare fits, not points, so that each costs O(1).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.perception.beams import concatenated_ranges
from hiermap_cli.perception.fitting import Lines, fit_moments, moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

MAX_LEVELS = 64  # a run of n points needs at most n levels; noise needs about ten


def split(
    beams: Beams, breaks: Mask, laser: LaserConfig, config: SegmentationConfig
) -> tuple[Index, Index]:
    """First and last point (inclusive) of every straight run, in order: (R,), (R,)."""
    starts = np.flatnonzero(breaks)
    cut = breaks.copy()
    first = starts
    last = np.append(starts[1:], len(breaks)) - 1
    for _ in range(MAX_LEVELS):
        long_enough = last - first >= 2
        first, last = first[long_enough], last[long_enough]
        if not len(first):
            break
        at, bends = _farthest(beams, first, last, laser, config)
        first, last, at = first[bends], last[bends], at[bends]
        cut[at + 1] = True
        first, last = np.concatenate((first, at + 1)), np.concatenate((at, last))
    first = np.flatnonzero(cut)
    return first, np.append(first[1:], len(cut)) - 1


def _farthest(
    beams: Beams, first: Index, last: Index, laser: LaserConfig, config: SegmentationConfig
) -> tuple[Index, Mask]:
    """The point of each run farthest from its chord, and whether it is too far."""
    count = last - first + 1
    index = concatenated_ranges(first, count)
    starts = np.cumsum(count) - count
    x, y = beams.x, beams.y
    tx, ty = x[last] - x[first], y[last] - y[first]
    chord = np.hypot(tx, ty)
    chord[chord == 0.0] = 1.0
    nx, ny = -ty / chord, tx / chord
    d = nx * x[first] + ny * y[first]
    distance = np.repeat(nx, count) * x[index]
    distance += np.repeat(ny, count) * y[index]
    distance -= np.repeat(d, count)
    np.abs(distance, out=distance)
    most = np.maximum.reduceat(distance, starts)
    hits = np.flatnonzero(distance == np.repeat(most, count))
    at = index[hits[np.searchsorted(hits, starts)]]
    at = np.clip(at, first, last - 1)
    sigma = laser.sigma_range + laser.sigma_range_scale * beams.r[at]
    cosine = np.abs(nx * beams.dx[at] + ny * beams.dy[at])
    return at, most > np.maximum(config.split_floor, config.split_sigmas * sigma * cosine)


class Pieces(NamedTuple):
    """Segments as merged runs: K segments, in order of their first point.

    sums: (6, K) moments. first, last: (K,) extreme points. run_segment: (R,) the segment of each
    run that is part of one, with run_first, run_last: (R,) its points; runs in order.
    """

    sums: Array
    first: Index
    last: Index
    run_first: Index
    run_last: Index
    run_segment: Index


def merge(
    beams: Beams,
    sums: Array,
    values: Array,
    runs: tuple[Index, Index],
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Pieces:
    """Merge runs of one line into segments, first neighbours, then over what stands before them."""
    first, last = runs
    solid = last - first + 1 >= 3
    first, last = first[solid], last[solid]
    pieces = Pieces(
        moments(sums, values, first, last), first, last, first, last, np.arange(len(first))
    )
    for _ in range(8):
        merged = _merge_once(beams, pieces, 1, laser, config)
        if merged is None:
            break
        pieces = merged
    pieces = keep_segments(pieces, pieces.sums[0] >= min(config.min_points, 4))
    for offset in (1, 2, 3, 4) if config.merge_gap else (1,):
        for _ in range(4):
            merged = _merge_once(beams, pieces, offset, laser, config)
            if merged is None:
                break
            pieces = merged
    return pieces


def keep_segments(pieces: Pieces, keep: Mask) -> Pieces:
    """The segments of `keep` (K,) with their runs, renumbered."""
    number = np.cumsum(keep) - 1
    runs = keep[pieces.run_segment]
    return Pieces(
        pieces.sums[:, keep],
        pieces.first[keep],
        pieces.last[keep],
        pieces.run_first[runs],
        pieces.run_last[runs],
        number[pieces.run_segment[runs]],
    )


def _merge_once(
    beams: Beams, pieces: Pieces, offset: int, laser: LaserConfig, config: SegmentationConfig
) -> Pieces | None:
    """One round of merges of segment i with i + offset; None when there is none."""
    count = len(pieces.first)
    if count <= offset:
        return None
    width = beams.ranges.shape[1]
    i = np.arange(count - offset)
    j = i + offset
    scan = beams.cell[pieces.first] // width
    same = scan[i] == scan[j]
    # Only whole neighbours: with an occluder between, both sides must lie beyond it.
    same &= pieces.last[i] < pieces.first[j]
    i, j = i[same], j[same]
    if not len(i):
        return None
    both = pieces.sums[:, i] + pieces.sums[:, j]
    line = fit_moments(both)
    deviation = _deviation(beams, pieces, i, j, line, laser, config)
    good = deviation < 1.0
    i, j, deviation, line = i[good], j[good], deviation[good], line.take(good)
    if not len(i):
        return None
    passes = _gap_allows(beams, pieces.last[i], pieces.first[j], line, laser, config)
    i, j, deviation = i[passes], j[passes], deviation[passes]
    if not len(i):
        return None
    # Of merges that share a segment only the best is made in this round.
    cost = np.full(count, np.inf)
    np.minimum.at(cost, i, deviation)
    np.minimum.at(cost, j, deviation)
    best = (deviation <= cost[i]) & (deviation <= cost[j])
    i, j = i[best], j[best]
    taken = np.zeros(count, dtype=bool)
    taken[j] = True
    free = ~taken[i]  # equal costs in a row
    i, j = i[free], j[free]
    into = np.arange(count)
    into[j] = i
    sums = pieces.sums.copy()
    sums[:, i] += pieces.sums[:, j]
    last = pieces.last.copy()
    last[i] = pieces.last[j]
    gone = np.zeros(count, dtype=bool)
    gone[j] = True
    joined = Pieces(
        sums, pieces.first, last, pieces.run_first, pieces.run_last, into[pieces.run_segment]
    )
    return keep_segments(joined, ~gone)


def _deviation(
    beams: Beams,
    pieces: Pieces,
    i: Index,
    j: Index,
    line: Lines,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Array:
    """How far the ends of the two fits lie off the common line, in units of what is allowed."""
    worst = np.zeros(len(i))
    for k in (i, j):
        own = fit_moments(pieces.sums[:, k])
        n = pieces.sums[0, k]
        for point in (pieces.first[k], pieces.last[k]):
            x, y = beams.x[point], beams.y[point]
            off = own.nx * x + own.ny * y - own.d
            px, py = x - off * own.nx, y - off * own.ny
            sigma = laser.sigma_range + laser.sigma_range_scale * beams.r[point]
            cosine = np.abs(line.nx * beams.dx[point] + line.ny * beams.dy[point])
            noise = config.split_sigmas * sigma * cosine
            allowed = np.sqrt((0.5 * config.split_floor) ** 2 + noise * noise * 4.0 / n)
            deviation = np.abs(line.nx * px + line.ny * py - line.d) / allowed
            worst = np.maximum(worst, deviation)
    return worst


def _gap_allows(
    beams: Beams,
    last: Index,
    first: Index,
    line: Lines,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Mask:
    """Whether nothing between the two runs shows that the wall is missing there.

    Beams between must say nothing, end on the line or before it; one beam alone may go farther.
    """
    between = beams.cell[first] - beams.cell[last] - 1
    ok = np.ones(len(first), dtype=bool)
    open_ = np.flatnonzero(between > 0)
    if not len(open_):
        return ok
    count = between[open_]
    cells = concatenated_ranges(beams.cell[last[open_]] + 1, count)
    starts = np.cumsum(count) - count
    nx, ny, d = (np.repeat(v[open_], count) for v in line)
    beam = beams.beam(cells)
    cosine = nx * beams.ux[beam] + ny * beams.uy[beam]
    r = beams.ranges.ravel()[cells]
    with np.errstate(invalid="ignore", divide="ignore"):
        off = r * cosine - d
        far = (off > 2.0 * config.split_floor) & (cosine > 0.0)
        off_line = ~(np.abs(off) <= config.split_floor)
    farther = np.add.reduceat(far.astype(np.int64), starts)
    unknown = np.add.reduceat(off_line.astype(np.int64), starts)
    length = np.hypot(beams.x[first] - beams.x[last], beams.y[first] - beams.y[last])[open_]
    short = length <= config.merge_gap
    ok[open_] = ((farther == 0) | (short & (farther == 1))) & ((unknown <= 1) | short)
    return ok
