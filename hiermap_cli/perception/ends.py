"""The two ends of each segment: where they lie, how well that is known, and what kind they are.

What decides is where the beams beyond the end go, against the segment's line: farther means that
the surface ends here, nearer that something hides the rest. Neighbours whose lines meet where both
end make a vertex.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.perception.fitting import Lines
from hiermap_cli.perception.segments import END_FREE, END_OPEN, END_VERTEX

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

LOOK = np.array((1, 2, 3, 4, 6, 8))  # beams beyond the end that are asked, while undecided
LOOSE = 9  # beams between the ends of two segments that may meet in a vertex, and one
VERTEX_SINE = 0.17  # lines that differ by less than about ten degrees make no vertex
GRAZING = 0.02  # cosine of incidence below which a beam does not meet the line any more


class Ends(NamedTuple):
    """Ends of K segments about the laser; column 0 is the first end, 1 the last.

    x, y: (K, 2) of p1, p2. kind: (K, 2). sigma: (K, 2) along the line.
    """

    x: Array
    y: Array
    kind: Index
    sigma: Array


class _Extremes(NamedTuple):
    """What is known of the extreme points, all (K, 2).

    row, column: their scan and column. x, y: their projections on the line; along: where on it,
    growing from first to last. met: where their beam meets the line. spacing: between beams there;
    blur: sigma of `along` by the noise of the range.
    """

    row: Index
    column: Index
    x: Array
    y: Array
    along: Array
    met: Array
    spacing: Array
    blur: Array


def describe_ends(
    beams: Beams,
    first: Index,
    last: Index,
    lines: Lines,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Ends:
    """Ends of the segments whose extreme points are `first` and `last`, (K,) each.

    A free end lies anywhere between its last beam and the next one that passes: its mean is the
    middle, and its sigma that of a uniform distribution. Other ends are where the last point is.
    """
    # Column vectors, so that both ends go together.
    upright = Lines(*(v[:, None] for v in lines))
    ends = _extremes(beams, np.stack((first, last), axis=1), upright, laser)
    kind, passing = _beyond(beams, ends, upright, laser, config)
    _vertices(beams, ends, lines, kind)
    free = kind == END_FREE
    width = np.minimum(np.abs(passing - ends.met), 4.0 * LOOSE * ends.spacing)
    shift = np.where(free, 0.5 * width, 0.0) * np.array((-1.0, 1.0))
    sigma = np.where(free, width / np.sqrt(12.0), ends.spacing / np.sqrt(3.0))
    return Ends(
        ends.x - shift * upright.ny,
        ends.y + shift * upright.nx,
        kind,
        np.sqrt(sigma * sigma + ends.blur * ends.blur),
    )


def _extremes(beams: Beams, point: Index, lines: Lines, laser: LaserConfig) -> _Extremes:
    """The extreme points (K, 2) of the segments against their lines."""
    nx, ny, d = lines
    x, y, r = beams.x[point], beams.y[point], beams.r[point]
    off = nx * x + ny * y - d
    x, y = x - off * nx, y - off * ny
    dx, dy = beams.dx[point], beams.dy[point]
    cosine = np.maximum(nx * dx + ny * dy, GRAZING)
    sine = nx * dy - ny * dx
    row, column = np.divmod(beams.cell[point], beams.ranges.shape[1])
    sigma = laser.sigma_range + laser.sigma_range_scale * r
    bearing = laser.sigma_bearing * r * cosine
    return _Extremes(
        row,
        column,
        x,
        y,
        nx * y - ny * x,
        d * sine / cosine,
        r * beams.spacing / cosine,
        np.hypot(sigma * sine, bearing),
    )


def _beyond(
    beams: Beams, ends: _Extremes, lines: Lines, laser: LaserConfig, config: SegmentationConfig
) -> tuple[Index, Array]:
    """Kinds of the ends (K, 2) by the beams beyond, and where the first one off the line met it."""
    width = beams.ranges.shape[1]
    column = ends.column[:, :, None] + np.array((-1, 1))[None, :, None] * LOOK
    if beams.cyclic:
        column %= width
        r = beams.ranges[ends.row[:, :, None], column]
    else:
        seen = (column >= 0) & (column < width)
        column = np.clip(column, 0, width - 1)
        r = np.where(seen, beams.ranges[ends.row[:, :, None], column], np.nan)
    beam = beams.beam(ends.row[:, :, None] * width + column)
    ux, uy = beams.ux[beam], beams.uy[beam]
    nx, ny, d = (v[:, :, None] for v in lines)
    cosine = nx * ux + ny * uy
    meets = cosine > GRAZING
    cosine = np.maximum(cosine, GRAZING)
    sigma = laser.sigma_range + laser.sigma_range_scale * np.minimum(r, beams.reach)
    tolerance = np.maximum(config.split_floor, config.split_sigmas * sigma * cosine)
    depth = np.where(meets, r * cosine - d, np.inf)
    unseen = np.isnan(r) | (np.isposinf(r) & (d >= beams.reach * cosine))
    off_line = ~unseen & (depth > tolerance)
    free = ~unseen & (depth > np.maximum(config.free_depth, 2.0 * tolerance))
    decided = free | unseen | (depth < -tolerance)
    at = np.argmax(decided, axis=2)[:, :, None]
    free_end = np.take_along_axis(free, at, axis=2)[:, :, 0]
    away = np.argmax(off_line, axis=2)[:, :, None]
    passing = np.take_along_axis(d * (nx * uy - ny * ux) / cosine, away, axis=2)[:, :, 0]
    return np.where(free_end, END_FREE, END_OPEN).astype(np.int64), passing


def _vertices(beams: Beams, ends: _Extremes, lines: Lines, kind: Index) -> None:
    """Set END_VERTEX in `kind` (K, 2) where a segment and the next of its scan meet in a corner."""
    total = len(kind)
    a = np.arange(total)
    b = a + 1
    b[-1] = 0
    scan = ends.row[:, 0]
    gap = ends.column[b, 0] - ends.column[a, 1]
    if beams.cyclic:
        # The last segment of a scan is followed by its first.
        opening = np.flatnonzero(np.diff(scan, prepend=-1))
        closing = np.append(opening[1:], total) - 1
        b[closing] = opening
        gap[closing] = ends.column[opening, 0] - ends.column[closing, 1]
        gap = np.where(gap < 0, gap + beams.ranges.shape[1], gap)
    near = (scan[a] == scan[b]) & (a != b) & (gap >= 1) & (gap <= LOOSE)
    a, b, gap = a[near], b[near], gap[near]
    sine = lines.nx[a] * lines.ny[b] - lines.ny[a] * lines.nx[b]
    crossing = np.abs(sine) > VERTEX_SINE
    a, b, gap, sine = a[crossing], b[crossing], gap[crossing], sine[crossing]
    ax, ay, ad = lines.take(a)
    bx, by, bd = lines.take(b)
    x, y = (ad * by - bd * ay) / sine, (bd * ax - ad * bx) / sine
    past_a = np.abs(ax * y - ay * x - ends.along[a, 1])
    past_b = np.abs(bx * y - by * x - ends.along[b, 0])
    reach = 1.5 * gap
    meet = past_a < reach * ends.spacing[a, 1] + 4.0 * ends.blur[a, 1] + 0.03
    meet &= past_b < reach * ends.spacing[b, 0] + 4.0 * ends.blur[b, 0] + 0.03
    kind[a[meet], 1] = END_VERTEX
    kind[b[meet], 0] = END_VERTEX
