"""Splitting runs of points into straight ones, level by level over all scans of a block at once.

A run that bends is split at the point farthest from its chord. One level does this for every run
of the block with `ufunc.reduceat`; the number of levels is that of the most crooked run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


class _Runs(NamedTuple):
    """K runs with the point of each that is farthest from its chord.

    first, last: (K,) its points, inclusive. at: (K,) the farthest, but never the last, as it goes
    to the left part. most, chord: (K,) its distance and the chord's length, metres. nx, ny: (K,)
    the chord's unit normal.
    """

    first: Index
    last: Index
    at: Index
    most: Array
    chord: Array
    nx: Array
    ny: Array

    def take(self, index: Index) -> _Runs:
        """The runs at `index`."""
        return _Runs._make(v.take(index) for v in self)


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
        enough = np.flatnonzero(last - first + 1 >= config.min_points)
        if not len(enough):
            break
        runs = _farthest(beams, *_by_length(first.take(enough), last.take(enough)))
        size = np.maximum(runs.chord, runs.most)
        runs = runs.take(
            np.flatnonzero((runs.most > config.split_floor) & (size > 0.5 * config.min_length))
        )
        # Few are left: is it more than noise, across the chord?
        r = beams.r.take(runs.at)
        sigma = laser.sigma_range + laser.sigma_range_scale * r
        cosine = (runs.nx * beams.x.take(runs.at) + runs.ny * beams.y.take(runs.at)) / r
        real = np.flatnonzero(runs.most > config.split_sigmas * sigma * np.abs(cosine))
        first, last, at = (v.take(real) for v in runs[:3])
        cut[at + 1] = True
        first, last = np.concatenate((first, at + 1)), np.concatenate((at, last))
    first = np.flatnonzero(cut)
    return first, np.append(first[1:], len(cut)) - 1


def _by_length(first: Index, last: Index) -> tuple[Index, Index]:
    """The runs in the order of their lengths, among those of about a dozen scans.

    Where equally long runs follow one another, the processor foretells where each ends, which
    halves the time of what is done run by run; points that are near in memory stay so.
    """
    key = (first >> 12 << 8) + np.minimum(last - first, 255)
    order = np.argsort(key.astype(np.uint16), kind="stable")  # 16 bits: a radix sort
    return first.take(order), last.take(order)


def _farthest(beams: Beams, first: Index, last: Index) -> _Runs:
    """The runs from `first` to `last` (K,) with the point of each farthest from its chord."""
    count = last - first + 1
    stop = np.cumsum(count)
    starts = stop - count
    place = np.arange(stop[-1])
    place -= np.repeat(starts, count)
    point = place + np.repeat(first, count)
    x0, y0 = beams.x.take(first), beams.y.take(first)
    nx, ny = y0 - beams.y.take(last), beams.x.take(last) - x0
    chord = np.sqrt(nx * nx + ny * ny)
    scale = 1.0 / np.maximum(chord, 1e-12)
    nx *= scale
    ny *= scale
    distance = beams.x.take(point, mode="clip")
    distance *= np.repeat(nx, count)
    term = beams.y.take(point, mode="clip")
    term *= np.repeat(ny, count)
    distance += term
    distance -= np.repeat(nx * x0 + ny * y0, count)
    # Distance and place are looked for at one stroke: positive numbers are ordered as their bits
    # are, and the lowest of these (1e-13 of the distance for 360 beams) make room for the place,
    # from behind, so that of equal ones the first is found. The sign goes, too.
    low = (1 << beams.ranges.shape[1].bit_length()) - 1
    bits = distance.view(np.int64)
    bits &= (1 << 63) - 1 - low
    bits += low
    bits -= place
    top = np.maximum.reduceat(bits, starts)
    at = first + low - (top & low)
    return _Runs(first, last, np.minimum(at, last - 1), top.view(np.float64), chord, nx, ny)
