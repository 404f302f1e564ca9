"""Splitting runs of points into straight ones, level by level over all scans of a block at once.

A run that bends is split at the point farthest from its chord. One level does this for every run
of the block with `ufunc.reduceat`; the number of levels is that of the most crooked run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.perception.beams import concatenated_ranges

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams

    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


def split(
    beams: Beams, breaks: Mask, laser: LaserConfig, config: SegmentationConfig
) -> tuple[Index, Index]:
    """First and last point (inclusive) of every straight run, in order: (R,), (R,).

    Runs of fewer than `min_points` are not split any further.
    """
    cut = breaks.copy()
    first = np.flatnonzero(breaks)
    last = np.append(first[1:], len(breaks)) - 1
    while True:
        enough = last - first + 1 >= config.min_points
        first, last = first[enough], last[enough]
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
    """The point of each run farthest from its chord, and whether it is too far.

    The point goes to the left part; a run is never split behind its last point.
    """
    count = last - first + 1
    index = concatenated_ranges(first, count)
    starts = np.cumsum(count) - count
    x, y = beams.x, beams.y
    tx, ty = x[last] - x[first], y[last] - y[first]
    chord = np.sqrt(tx * tx + ty * ty)
    chord[chord == 0.0] = 1.0
    nx, ny = -ty / chord, tx / chord
    d = nx * x[first] + ny * y[first]
    distance = np.repeat(nx, count)
    distance *= x[index]
    term = np.repeat(ny, count)
    term *= y[index]
    distance += term
    distance -= np.repeat(d, count)
    np.abs(distance, out=distance)
    most = np.maximum.reduceat(distance, starts)
    hits = np.flatnonzero(distance == np.repeat(most, count))
    at = np.minimum(index[hits[np.searchsorted(hits, starts)]], last - 1)
    sigma = laser.sigma_range + laser.sigma_range_scale * beams.r[at]
    cosine = np.abs(nx * beams.dx[at] + ny * beams.dy[at])
    return at, most > np.maximum(config.split_floor, config.split_sigmas * sigma * cosine)
