"""Lines through runs of points: from prefix sums in O(1) a run, and to full accuracy.

A line is (nx, ny, d): the unit normal points away from the laser (to the material), d > 0 is its
distance from the laser. The first fits are unweighted and come from prefix sums, which are kept
scan by scan about the laser's origin. They decide splits and merges only: the final fit works on
residuals, so that no digits are lost, and is the maximum likelihood one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

GRAZING = 0.01  # cosine of incidence below which a beam is taken to be that steep


class Lines(NamedTuple):
    """K lines in Hesse form about the laser: nx, ny, d, each (K,)."""

    nx: Array
    ny: Array
    d: Array

    def take(self, index: Index | NDArray[np.bool_]) -> Lines:
        """The lines at `index`."""
        return Lines(self.nx[index], self.ny[index], self.d[index])


def prefix_sums(beams: Beams) -> Array:
    """Inclusive sums over the points of each scan of 1, x, y, xx, xy, yy: (6, N + 1).

    Column i + 1 holds the sums up to point i within its scan; differences are only meant between
    points of one scan.
    """
    count, width = beams.ranges.shape
    dense = np.zeros((6, count * width))
    x, y = beams.x, beams.y
    for row, values in zip(dense, (1.0, x, y, x * x, x * y, y * y), strict=True):
        row[beams.cell] = values
    dense = dense.reshape(6, count, width).cumsum(axis=2).reshape(6, -1)
    return dense[:, beams.cell]


def moments(sums: Array, values: Array, first: Index, last: Index) -> Array:
    """Sums over the points `first..last` (inclusive, of one scan each): (6, K)."""
    return sums[:, last] - sums[:, first] + values[:, first]


def point_moments(beams: Beams) -> Array:
    """The summands of `prefix_sums` themselves: (6, N)."""
    x, y = beams.x, beams.y
    return np.stack((np.ones_like(x), x, y, x * x, x * y, y * y))


def fit_moments(sums: Array) -> Lines:
    """Unweighted total least squares lines of moments (6, K); normals away from the laser."""
    n, sx, sy, sxx, sxy, syy = sums
    mx, my = sx / n, sy / n
    xx, xy, yy = sxx - sx * mx, sxy - sx * my, syy - sy * my
    # The normal is the axis of the smaller eigenvalue of the scatter matrix.
    alpha = 0.5 * np.arctan2(-2.0 * xy, yy - xx)
    nx, ny = np.cos(alpha), np.sin(alpha)
    d = nx * mx + ny * my
    sign = np.where(d < 0.0, -1.0, 1.0)
    return Lines(sign * nx, sign * ny, sign * d)


class Fit(NamedTuple):
    """Lines after a step of `refine`, their centres and variances, and residuals before it.

    cx, cy: (K,) weighted centre. var_alpha, var_d: (K,) variances of the angle and of the
    offset at the centre. residual: (M,) of each point, perpendicular; weight: (M,) as used.
    """

    lines: Lines
    cx: Array
    cy: Array
    var_alpha: Array
    var_d: Array
    residual: Array
    weight: Array


def refine(
    beams: Beams,
    index: Index,
    starts: Index,
    lines: Lines,
    laser: LaserConfig,
    uneven: Array | None = None,
    keep: NDArray[np.bool_] | None = None,
) -> Fit:
    """One Gauss-Newton step of the maximum likelihood fit of ranges along known bearings.

    The noise acts along the beam, so that the point is compared with where its beam meets the
    line; perpendicular to the wall the noise is sigma_r cos(incidence), which must come from the
    line and not from the measured range, or far points pull the line outwards. Seen from the
    centre the residual n . p - d changes by s dalpha - dd when the line turns and moves.

    Args:
        beams: the block.
        index: (M,) points, segment after segment.
        starts: (K,) where each segment begins in `index`.
        lines: (K,) the lines to start from.
        laser: noise of ranges and bearings.
        uneven: (K,) variance of the wall itself, added to each point's.
        keep: (M,) points that count; all if None.
    """
    counts = np.diff(starts, append=len(index))
    nx, ny, d = (np.repeat(v, counts) for v in lines)
    x, y, ux, uy = beams.x[index], beams.y[index], beams.dx[index], beams.dy[index]
    residual = nx * x + ny * y - d
    cosine = np.maximum(nx * ux + ny * uy, GRAZING)
    off_beam = residual / cosine
    along = nx * uy - ny * ux  # the beam's component along the wall
    s = nx * y - ny * x - off_beam * along
    sigma = laser.sigma_range * np.ones(1)
    if laser.sigma_range_scale or laser.sigma_bearing:
        reach = np.abs(beams.r[index] - off_beam)
        sigma = laser.sigma_range + laser.sigma_range_scale * reach
        variance = (sigma * cosine) ** 2 + (laser.sigma_bearing * reach * along) ** 2
    else:
        variance = (sigma * cosine) ** 2
    if uneven is not None:
        variance += np.repeat(uneven, counts)
    weight = 1.0 / variance
    if keep is not None:
        weight *= keep
    ws, we = weight * s, weight * residual
    W = np.add.reduceat(weight, starts)
    Ws, We = np.add.reduceat(ws, starts), np.add.reduceat(we, starts)
    Wss, Wes = np.add.reduceat(ws * s, starts), np.add.reduceat(we * s, starts)
    s0, dd = Ws / W, We / W
    Sss = Wss - Ws * s0
    turn = -(Wes - We * s0) / Sss
    n0x, n0y, d0 = lines
    cx = (d0 + dd) * n0x - s0 * n0y
    cy = (d0 + dd) * n0y + s0 * n0x
    c, sn = np.cos(turn), np.sin(turn)
    n1x, n1y = c * n0x - sn * n0y, sn * n0x + c * n0y
    fitted = Lines(n1x, n1y, n1x * cx + n1y * cy)
    return Fit(fitted, cx, cy, 1.0 / Sss, 1.0 / W, residual, weight)
