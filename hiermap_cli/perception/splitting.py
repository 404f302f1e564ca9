"""Splitting runs of points into straight ones, level by level over all scans of a block at once.

A run that bends is split at the point farthest from its chord. One level does this for every run
of the block with `ufunc.reduceat`; the number of levels is that of the most crooked run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


def split(
    beams: Beams, breaks: Mask, laser: LaserConfig, config: SegmentationConfig
) -> tuple[Index, Index]:
    """First and last point (inclusive) of every straight run, in order: (R,), (R,).

    Runs of fewer than `min_points`, or too small to hold a segment, are not split any further.
    """
    cut = breaks.copy()
    first = np.flatnonzero(breaks)
    last = np.append(first[1:], len(breaks)) - 1
    while True:
        enough = last - first + 1 >= config.min_points
        first, last = first[enough], last[enough]
        if not len(first):
            break
        at, most, chord, nx, ny = _farthest(beams, first, last)
        bends = np.flatnonzero(
            (most > config.split_floor) & (np.maximum(chord, most) > 0.5 * config.min_length)
        )
        first, last, at = first.take(bends), last.take(bends), at.take(bends)
        # Few are left: is it more than noise, across the chord?
        sigma = laser.sigma_range + laser.sigma_range_scale * beams.r.take(at)
        cosine = nx.take(bends) * beams.dx.take(at) + ny.take(bends) * beams.dy.take(at)
        real = most.take(bends) > config.split_sigmas * sigma * np.abs(cosine)
        first, last, at = first[real], last[real], at[real]
        cut[at + 1] = True
        first, last = np.concatenate((first, at + 1)), np.concatenate((at, last))
    first = np.flatnonzero(cut)
    return first, np.append(first[1:], len(cut)) - 1


def _farthest(beams: Beams, first: Index, last: Index) -> tuple[Index, Array, Array, Array, Array]:
    """The point of each run farthest from its chord, that distance, and the chord; all (K,).

    The point is never the last of its run, as it goes to the left part. Of the chord the length,
    metres like the distance, and the unit normal's x and y.
    """
    count = last - first + 1
    stop = np.cumsum(count)
    starts = stop - count
    index = np.arange(stop[-1])
    index += np.repeat(first - starts, count)
    x0, y0 = beams.x.take(first), beams.y.take(first)
    nx, ny = y0 - beams.y.take(last), beams.x.take(last) - x0
    chord = np.sqrt(nx * nx + ny * ny)
    scale = 1.0 / np.maximum(chord, 1e-12)
    nx *= scale
    ny *= scale
    distance = beams.x.take(index, mode="clip")
    distance *= np.repeat(nx, count)
    term = beams.y.take(index, mode="clip")
    term *= np.repeat(ny, count)
    distance += term
    distance -= np.repeat(nx * x0 + ny * y0, count)
    np.abs(distance, out=distance)
    most = np.maximum.reduceat(distance, starts)
    hits = np.flatnonzero(distance == np.repeat(most, count))
    at = index.take(hits.take(np.searchsorted(hits, starts)))
    return np.minimum(at, last - 1), most, chord, nx, ny
