"""The two ends of each segment: where they lie, how well that is known, and what kind they are.

What decides is where the beams beyond the end go, against the segment's line: farther means that
the surface ends here, nearer that something hides the rest. Neighbours whose lines meet where both
end make a vertex.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.perception.segments import END_FREE, END_OPEN, END_VERTEX

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams
    from hiermap_cli.perception.fitting import Fit, Lines

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

LOOK = np.array((1, 2, 3, 4, 5))  # beams beyond the end that are asked, while undecided
NEXT = 4  # of these, so many beams may still be of the surface
LOOSE = 9  # beams between the ends of two segments that may meet in a vertex, and one
OUTWARDS = np.array(((-1,), (1,)))  # which way is out, at the first end and at the last
VERTEX_SINE = 0.17  # lines that differ by less than about ten degrees make no vertex
BLIND = 0.5  # metres along the line that the face of a wall's end may be taken for the wall
GRAZING = 0.02  # cosine of incidence below which a beam does not meet the line any more


class Ends(NamedTuple):
    """Ends of K segments about the laser; row 0 is the first end, 1 the last.

    x, y: (2, K) of p1, p2. kind: (2, K). sigma: (2, K) along the line.
    """

    x: Array
    y: Array
    kind: Index
    sigma: Array


class _Extremes(NamedTuple):
    """What is known of the extreme points, all (2, K).

    row, column: their scan and column. along: where on the line they are, growing from first to
    last. met: where their beam meets the line. spacing: between beams there. slope: tangent of
    the incidence. range_blur, bearing_blur: sigmas along the line by the noise of each.
    depth_noise: metres behind the line that are still on it.
    """

    row: Index
    column: Index
    along: Array
    met: Array
    spacing: Array
    slope: Array
    range_blur: Array
    bearing_blur: Array
    depth_noise: Array


def describe_ends(
    beams: Beams,
    first: Index,
    last: Index,
    fit: Fit,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Ends:
    """Ends of the segments whose extreme points are `first` and `last`, (K,) each.

    A free end or a vertex lies anywhere between where its last beam meets the line and where the
    next does that is of something else: its mean is the middle, and its sigma that of a uniform
    distribution and of the line there. Open ends are where the last point is projected.

    Looking back at a wall past its end, one sees the face of that end too: beams that meet it
    not deeper than the noise are taken for ones on the wall, which so seems longer.
    """
    lines = fit.lines
    ends = _extremes(beams, np.stack((first, last)), lines, laser, config)
    kind, reached, passing = _beyond(beams, ends, lines, laser, config)
    a, b = _vertices(beams, ends, lines, config)
    apart = _parted(beams, ends, lines, a, b, laser, config)
    sure = [_meeting(beams, lines.take(own), apart) for own in (a, b)]
    unknown = [np.abs(bracket[1] - bracket[0]) > config.vertex_width for bracket in sure]
    at_end = np.stack((beams.cell[last[a]], beams.cell[first[b]]))
    for side, own, k in ((1, a, 0), (0, b, 1)):
        bracket = np.where(unknown[k], sure[k], _meeting(beams, lines.take(own), at_end))
        met = ~unknown[1 - k]
        at = own[met]
        kind[side, at] = END_VERTEX
        reached[side, at], passing[side, at] = bracket[[k, 1 - k]][:, met]
    true = kind != END_OPEN
    width = np.minimum(np.abs(passing - reached), 4.0 * LOOSE * ends.spacing)
    # The middle of the bearings, as the beams lie anyhow: nearer to the laser than half way.
    passing = reached + width * OUTWARDS
    past = (kind == END_FREE) & (ends.along * OUTWARDS < 0.0)
    blind = np.where(past, np.minimum(ends.depth_noise * np.abs(ends.slope), BLIND), 0.0)
    reached, passing = reached - blind * OUTWARDS, passing - blind * OUTWARDS
    square = lines.d * lines.d
    near, far = np.sqrt(square + reached * reached), np.sqrt(square + passing * passing)
    along = np.where(true, (reached * far + passing * near) / (near + far), ends.along)
    nx, ny, d = lines
    lever = along - (nx * fit.cy - ny * fit.cx)
    across = (fit.var_d + lever * lever * fit.var_alpha) * ends.slope**2
    variance = np.where(
        true,
        (width * width + blind * blind) / 12.0 + across,
        ends.spacing**2 / 3.0 + ends.range_blur**2,
    )
    return Ends(
        d * nx - along * ny,
        d * ny + along * nx,
        kind,
        np.sqrt(variance + ends.bearing_blur**2),
    )


def _extremes(
    beams: Beams, point: Index, lines: Lines, laser: LaserConfig, config: SegmentationConfig
) -> _Extremes:
    """The extreme points (2, K) of the segments against their lines."""
    nx, ny, d = lines
    x, y, r = beams.x.take(point), beams.y.take(point), beams.r.take(point)
    cosine = np.maximum((nx * x + ny * y) / r, GRAZING)
    along = nx * y - ny * x
    sine = along / r
    row, column = np.divmod(beams.cell[point], beams.ranges.shape[1])
    sigma = laser.sigma_range + laser.sigma_range_scale * r
    return _Extremes(
        row,
        column,
        along=along,
        met=d * sine / cosine,
        spacing=r * beams.spacing / cosine,
        slope=sine / cosine,
        range_blur=sigma * np.abs(sine),
        bearing_blur=laser.sigma_bearing * r / cosine,
        depth_noise=config.outlier_sigmas * sigma * cosine,
    )


def _beyond(
    beams: Beams, ends: _Extremes, lines: Lines, laser: LaserConfig, config: SegmentationConfig
) -> tuple[Index, Array, Array]:
    """Kinds of the ends (2, K) by the beams beyond, and where the surface ends on the line.

    It ends between where the last beam that ended on the line met it, and where the next met it.
    """
    width = beams.ranges.shape[1]
    # The beams that are asked lie along the first axis, (m, 2, K).
    column = ends.column + LOOK[:, None, None] * OUTWARDS
    if beams.cyclic:
        column %= width
        cell = ends.row * width + column
        r = beams.ranges.take(cell)
    else:
        seen = (column >= 0) & (column < width)
        cell = ends.row * width + np.clip(column, 0, width - 1)
        r = np.where(seen, beams.ranges.take(cell), np.nan)
    beam = beams.beam(cell)
    ux, uy = beams.ux.take(beam), beams.uy.take(beam)
    nx, ny, d = lines
    cosine = nx * ux + ny * uy
    meets = cosine > GRAZING
    cosine = np.maximum(cosine, GRAZING)
    sigma = laser.sigma_range + laser.sigma_range_scale * np.where(np.isfinite(r), r, 0.0)
    noise = config.outlier_sigmas * sigma * cosine
    tolerance = np.maximum(config.split_floor, noise)
    depth = np.where(meets, r * cosine - d, np.inf)
    unseen = np.isnan(r) | (np.isposinf(r) & (d >= beams.reach * cosine))
    free = ~unseen & (depth > np.maximum(config.free_depth, 2.0 * tolerance))
    decided = free | unseen | (depth < -tolerance)
    at = np.argmax(decided, axis=0)
    free_end = np.take_along_axis(free, at[None], axis=0)[0]
    met = np.concatenate((ends.met[None], d * (nx * uy - ny * ux) / cosine))
    step = np.arange(1, len(LOOK) + 1)[:, None, None]
    on_line = (np.abs(depth) <= noise) & (step <= np.minimum(at, NEXT))
    last = (on_line * step).max(axis=0)[None]
    reached, passing = (np.take_along_axis(met, k, axis=0)[0] for k in (last, last + 1))
    return np.where(free_end, END_FREE, END_OPEN).astype(np.int64), reached, passing


def _meeting(beams: Beams, lines: Lines, cell: Index) -> Array:
    """Where on the lines (K,) the beams of cells (..., K) meet them."""
    beam = beams.beam(cell)
    ux, uy = beams.ux.take(beam), beams.uy.take(beam)
    cosine = np.maximum(lines.nx * ux + lines.ny * uy, GRAZING)
    return np.asarray(lines.d * (lines.nx * uy - lines.ny * ux) / cosine)


def _parted(
    beams: Beams,
    ends: _Extremes,
    lines: Lines,
    a: Index,
    b: Index,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Index:
    """Cells (2, V) of the last beam that is on wall a only and the first that is on wall b only.

    A point within the noise of both lines may be of either wall; where both may be, the next
    beam is taken without a question.
    """
    width = beams.ranges.shape[1]
    gap = (ends.column[0, b] - ends.column[1, a]) % width
    step = np.arange(-1, LOOSE + 2)[:, None]
    cell = ends.row[1, a] * width + (ends.column[1, a] + step) % width
    r, beam = beams.ranges.take(cell), beams.beam(cell)
    ux, uy = beams.ux.take(beam), beams.uy.take(beam)
    sigma = laser.sigma_range + laser.sigma_range_scale * np.where(np.isfinite(r), r, 0.0)
    on = []
    for nx, ny, d in (lines.take(a), lines.take(b)):
        cosine = np.maximum(nx * ux + ny * uy, GRAZING)
        on.append(np.abs(r * cosine - d) <= config.outlier_sigmas * sigma * cosine)
    on_b = on[1] & ~on[0] & (step >= 0) & (step <= gap)
    first = np.where(on_b.any(axis=0), np.argmax(on_b, axis=0), gap + 2)
    index = np.arange(len(step))[:, None]
    on_a = on[0] & ~on[1] & (index < first)
    last = np.where(on_a.any(axis=0), len(step) - 1 - np.argmax(on_a[::-1], axis=0), 0)
    every = np.arange(len(a))
    return np.stack((cell[last, every], cell[first, every]))


def _vertices(
    beams: Beams, ends: _Extremes, lines: Lines, config: SegmentationConfig
) -> tuple[Index, Index]:
    """Segments (V,) whose last end meets the first end of other ones (V,) in a vertex.

    Their lines meet where both end, and the beams between, but for one, end on either wall.
    """
    total = ends.row.shape[1]
    a = np.arange(total)
    b = a + 1
    b[-1] = 0
    scan = ends.row[0]
    gap = ends.column[0, b] - ends.column[1, a]
    if beams.cyclic:
        # The last segment of a scan is followed by its first.
        opening = np.flatnonzero(np.diff(scan, prepend=-1))
        closing = np.append(opening[1:], total) - 1
        b[closing] = opening
        gap[closing] = ends.column[0, opening] - ends.column[1, closing]
        gap = np.where(gap < 0, gap + beams.ranges.shape[1], gap)
    near = (scan[a] == scan[b]) & (a != b) & (gap >= 1) & (gap <= LOOSE)
    a, b, gap = a[near], b[near], gap[near]
    sine = lines.nx[a] * lines.ny[b] - lines.ny[a] * lines.nx[b]
    crossing = np.abs(sine) > VERTEX_SINE
    a, b, gap, sine = a[crossing], b[crossing], gap[crossing], sine[crossing]
    ax, ay, ad = lines.take(a)
    bx, by, bd = lines.take(b)
    x, y = (ad * by - bd * ay) / sine, (bd * ax - ad * bx) / sine
    past_a = np.abs(ax * y - ay * x - ends.along[1, a])
    past_b = np.abs(bx * y - by * x - ends.along[0, b])
    reach = 1.5 * gap
    meet = past_a < reach * ends.spacing[1, a] + 4.0 * ends.range_blur[1, a] + 0.03
    meet &= past_b < reach * ends.spacing[0, b] + 4.0 * ends.range_blur[0, b] + 0.03
    a, b, gap = a[meet], b[meet], gap[meet]
    step = np.arange(1, LOOSE)[:, None]
    cell = ends.row[1, a] * beams.ranges.shape[1]
    cell = cell + (ends.column[1, a] + step) % beams.ranges.shape[1]
    r, beam = beams.ranges.take(cell), beams.beam(cell)
    ux, uy = beams.ux.take(beam), beams.uy.take(beam)
    off = [
        np.abs(r * np.maximum(nx * ux + ny * uy, GRAZING) - d)
        for nx, ny, d in (lines.take(a), lines.take(b))
    ]
    elsewhere = (np.fmin(*off) > 2.0 * config.split_floor) & (step < gap)
    whole = elsewhere.sum(axis=0) <= 1
    return a[whole], b[whole]
