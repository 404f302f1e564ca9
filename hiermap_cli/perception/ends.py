"""The two ends of each segment: where they lie, how well that is known, and what kind they are.

What decides is the beam after the last one of the segment, against the range at which it would
have met the segment's line: farther means that the surface ends here, nearer that something hides
the rest. Neighbours whose lines meet at both their ends make a vertex.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.perception.segments import END_FREE, END_OPEN, END_VERTEX

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.perception.beams import Beams
    from hiermap_cli.perception.fitting import Lines

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

LOOK = 3  # beams beyond the end that are asked, while they end on the line itself
VERTEX_SINE = 0.17  # lines that differ by less than about ten degrees make no vertex


class Ends(NamedTuple):
    """End `side` (0 first, 1 last) of K segments: points about the laser, kinds, sigmas.

    x, y: (K, 2) of p1, p2. kind: (K, 2). sigma: (K, 2) along the line.
    """

    x: Array
    y: Array
    kind: Index
    sigma: Array


def describe_ends(
    beams: Beams,
    first: Index,
    last: Index,
    lines: Lines,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Ends:
    """Ends of the segments whose extreme points are `first` and `last`, (K,) each."""
    count, width = beams.ranges.shape
    ranges = beams.ranges.ravel()
    extreme = np.stack((first, last), axis=1)
    nx, ny, d = (v[:, None] for v in lines)
    x, y = beams.x[extreme], beams.y[extreme]
    off = nx * x + ny * y - d
    px, py = x - off * nx, y - off * ny
    along = nx * py - ny * px
    cosine = np.clip(nx * beams.dx[extreme] + ny * beams.dy[extreme], 0.02, 1.0)
    spacing = beams.r[extreme] * beams.spacing / cosine
    sigma_r = laser.sigma_range + laser.sigma_range_scale * beams.r[extreme]
    blur = sigma_r * np.sqrt(1.0 - cosine * cosine)

    # The beams beyond each end: (K, 2, LOOK).
    outward = np.array([-1, 1])[None, :, None] * np.arange(1, LOOK + 1)
    row, column = np.divmod(beams.cell[extreme], width)
    column = column[:, :, None] + outward
    if beams.cyclic:
        column %= width
        seen = np.ones(column.shape, dtype=bool)
    else:
        seen = (column >= 0) & (column < width)
        column = np.clip(column, 0, width - 1)
    cell = row[:, :, None] * width + column
    r = np.where(seen, ranges[cell], np.nan)
    beam = beams.beam(cell)
    towards = lines.nx[:, None, None] * beams.ux[beam] + lines.ny[:, None, None] * beams.uy[beam]
    height = lines.d[:, None, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        met = np.where(towards > 0.02, height / towards, np.inf)
        beyond = r * towards - height
        tolerance = np.maximum(config.split_floor, 3.0 * sigma_r[:, :, None] * towards)
        limit = np.isposinf(r) & (met >= beams.reach)
        far = (np.isposinf(r) & ~limit) | (np.isfinite(r) & (beyond > tolerance))
        on_line = np.isfinite(r) & (np.abs(beyond) <= tolerance)
    kind = np.full(extreme.shape, END_OPEN, dtype=np.int64)
    undecided = np.ones(extreme.shape, dtype=bool)
    gap = np.zeros(extreme.shape)
    for k in range(LOOK):
        free = undecided & far[:, :, k]
        kind[free] = END_FREE
        # Where the line would be met next: the surface's end lies before that.
        sx = beams.ux[beam[:, :, k]] * met[:, :, k]
        sy = beams.uy[beam[:, :, k]] * met[:, :, k]
        with np.errstate(invalid="ignore"):
            step = np.abs(nx * sy - ny * sx - along)
        step = np.where(np.isfinite(step), step, np.inf)
        gap[free] = np.minimum(step, (k + 1) * 2.0 * spacing)[free]
        undecided &= on_line[:, :, k]
    _vertices(beams, row[:, 0], first, last, lines, along, spacing, blur, kind)

    # A free end lies anywhere between its last beam and the next: the middle is the mean.
    free = kind == END_FREE
    shift = np.where(free, 0.5 * gap, 0.0) * np.array([-1.0, 1.0])
    sigma = np.where(free, gap / np.sqrt(12.0), spacing / np.sqrt(3.0))
    sigma = np.sqrt(sigma * sigma + blur * blur)
    return Ends(px - shift * ny, py + shift * nx, kind, sigma)


def _vertices(
    beams: Beams,
    scan: Index,
    first: Index,
    last: Index,
    lines: Lines,
    along: Array,
    spacing: Array,
    blur: Array,
    kind: Index,
) -> None:
    """Set END_VERTEX in `kind` where a segment and the next of its scan meet in a corner."""
    total = len(first)
    a = np.arange(total)
    b = np.roll(a, -1)
    width = beams.ranges.shape[1]
    gap = beams.cell[first[b]] - beams.cell[last[a]]
    if beams.cyclic:
        # The last segment of a scan is followed by its first.
        opening = np.flatnonzero(np.diff(scan, prepend=-1) != 0)
        closing = np.append(opening[1:], total) - 1
        b[closing] = opening
        gap[closing] = beams.cell[first[opening]] + width - beams.cell[last[closing]]
    near = (scan[a] == scan[b]) & (a != b) & (gap >= 1) & (gap <= LOOK + 1)
    a, b = a[near], b[near]
    ax, ay, ad = lines.take(a)
    bx, by, bd = lines.take(b)
    sine = ax * by - ay * bx
    crossing = np.abs(sine) > VERTEX_SINE
    a, b, sine = a[crossing], b[crossing], sine[crossing]
    ax, ay, ad = lines.take(a)
    bx, by, bd = lines.take(b)
    vx, vy = (ad * by - bd * ay) / sine, (bd * ax - ad * bx) / sine
    beyond_a = ax * vy - ay * vx - along[a, 1]
    beyond_b = along[b, 0] - (bx * vy - by * vx)
    reach_a = 3.0 * spacing[a, 1] + 4.0 * blur[a, 1] + 0.02
    reach_b = 3.0 * spacing[b, 0] + 4.0 * blur[b, 0] + 0.02
    meet = (np.abs(beyond_a) < reach_a) & (np.abs(beyond_b) < reach_b)
    kind[a[meet], 1] = END_VERTEX
    kind[b[meet], 0] = END_VERTEX
