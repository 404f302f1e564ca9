"""Boundaries between neighbouring segments: which points at a corner belong to which line.

A point at a corner given to the wrong wall bends its line by far more than noise does. The boundary
goes where both lines explain their points best, and points that both explain belong to neither.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.perception.fitting import few_moments, fit_moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams
    from hiermap_cli.perception.fitting import Lines
    from hiermap_cli.perception.pieces import Pieces

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

WINDOW = 4  # points on each side of a boundary that may change sides
LOOSE = 3  # points of no segment between two neighbours that are shared out
UNSURE = 2  # points on each side of a boundary that do not help to place it
VAGUE = 2.0  # sigmas between two lines within which a point tells nothing about its side
STEEPEST = 0.05  # cosine of incidence below which a beam's distance from a line says nothing


def place_boundaries(
    beams: Beams, breaks: Mask, pieces: Pieces, laser: LaserConfig, config: SegmentationConfig
) -> tuple[Index, Index]:
    """New first and last points of the runs, (R,), (R,), where neighbours meet at a corner.

    Of every cut in the window around the old one, that with the least sum of squared residuals is
    taken; the lines for it are fitted without the points next to the old cut.
    """
    first, last = pieces.run_first.copy(), pieces.run_last.copy()
    owner = pieces.run_segment
    left = np.flatnonzero((first[1:] - last[:-1] - 1 <= LOOSE) & (owner[1:] != owner[:-1]))
    between = np.minimum(last[left] + np.arange(1, LOOSE + 2)[:, None], first[left + 1])
    left = left[~breaks[between].any(axis=0)]
    if not len(left):
        return first, last
    right = left + 1
    # Windows of points lie along the first axis, (size, K).
    step = np.arange(2 * WINDOW + LOOSE)[:, None]
    lo = np.maximum((first[left] + last[left]) // 2 + 1, last[left] - WINDOW + 1)
    hi = np.minimum((first[right] + last[right]) // 2, first[right] + WINDOW - 1)
    grid = lo + step
    inside = grid <= hi
    lines = _lines_at_cut(beams, pieces, left, right)
    off_left, off_right = _residuals(beams, lines, np.minimum(grid, hi))
    by_left, by_right = off_left * off_left * inside, off_right * off_right * inside
    # A cut at k gives the first k points of the window to the left: what that costs, beyond what
    # all cost on the right.
    cut = np.cumsum(by_left - by_right, axis=0)
    cut = np.where(cut.min(axis=0) < 0.0, np.argmin(cut, axis=0) + 1, 0)

    # Points gained must lie on the line: what is beyond one that does not, is nobody's. Where both
    # lines are the same within the noise, the side of a point would depend on its error.
    sigma = laser.sigma_range + laser.sigma_range_scale * beams.r[last[left]]
    allowed = np.maximum(0.5 * config.split_floor, config.split_sigmas * sigma) ** 2
    clear = np.abs(off_left - off_right) >= VAGUE * sigma
    size = len(step)
    lost = (by_left > allowed) & (grid > last[left])
    end = np.minimum(cut, np.where(lost, step, size).min(axis=0))
    end = np.maximum((clear * (step + 1) * (step < end)).max(axis=0), end - WINDOW)
    lost = (by_right > allowed) & (grid < first[right])
    begin = np.maximum(cut, (lost * (step + 1)).max(axis=0))
    begin = np.minimum(np.where(clear & (step >= begin), step, size).min(axis=0), begin + WINDOW)
    last[left] = np.maximum(lo + end - 1, first[left])
    first[right] = np.minimum(lo + begin, last[right])
    return first, last


def clear_seam(beams: Beams, pieces: Pieces, first: Index, last: Index) -> tuple[Index, Index]:
    """The runs (R,), (R,) of full circles without points at the seam that the other side explains.

    The seam lies at a wall's end, mostly in a corner; its points cannot change sides, but must not
    bend a line.
    """
    first, last = first.copy(), last.copy()
    owner, width = pieces.run_segment, beams.ranges.shape[1]
    opening = np.flatnonzero(np.diff(beams.cell[first] // width, prepend=-1))
    closing = np.append(opening[1:], len(first)) - 1
    near = beams.cell[first[opening]] + width - beams.cell[last[closing]] <= LOOSE + 1
    near &= owner[opening] != owner[closing]
    opening, closing = opening[near], closing[near]
    if not len(opening):
        return first, last
    lines = _lines_at_cut(beams, pieces, closing, opening)
    step = np.arange(WINDOW)[:, None]
    ahead = np.minimum(first[opening] + step, last[opening])
    behind = np.maximum(last[closing] - step, first[closing])
    for point, sign, end, run in ((ahead, 1, first, opening), (behind, -1, last, closing)):
        by_other, by_own = _residuals(beams, lines, point)[::sign]
        # The cut with the least sum of squared residuals, counted from the seam.
        gain = np.cumsum(by_other**2 - by_own**2, axis=0)
        drop = np.where(gain.min(axis=0) < 0.0, np.argmin(gain, axis=0) + 1, 0)
        end[run] += sign * np.minimum(drop, last[run] - first[run])
    return first, last


def _lines_at_cut(beams: Beams, pieces: Pieces, left: Index, right: Index) -> Lines:
    """Lines (2 K) of the segments of runs left and right of a cut, but for the points next to it.

    Those of the K left ones come first.
    """
    runs = np.concatenate((left, right))
    first, last = pieces.run_first[runs], pieces.run_last[runs]
    inwards = np.repeat((-1, 1), len(left))
    edge = np.where(inwards < 0, last, first)
    unsure = np.clip((last - first - 2) // 2, 0, UNSURE)
    step = np.arange(UNSURE)[:, None]
    point = edge + inwards * np.minimum(step, np.maximum(unsure - 1, 0))
    dropped = few_moments(beams.x.take(point), beams.y.take(point), step < unsure)
    return fit_moments(pieces.sums[:, pieces.run_segment[runs]] - dropped)[0]


def _residuals(beams: Beams, lines: Lines, point: Index) -> tuple[Array, Array]:
    """Distances of points (m, K) from the left and from the right lines of (2 K), along the beam.

    The noise is the same along any beam, so that these say which of two lines explains a point:
    across a wall seen steeply the noise is small.
    """
    count = point.shape[1]
    x, y, r = beams.x.take(point), beams.y.take(point), beams.r.take(point)
    dx, dy = x / r, y / r
    out = []
    for half in (slice(None, count), slice(count, None)):
        nx, ny, d = (v[half] for v in lines)
        out.append(r - d / np.maximum(nx * dx + ny * dy, STEEPEST))
    return out[0], out[1]
