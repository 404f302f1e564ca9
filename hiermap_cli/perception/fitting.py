"""Lines through runs of points: from their moments in O(1), and to full accuracy.

A line is (nx, ny, d): the unit normal points away from the laser (to the material), d >= 0 is its
distance from the laser. The first fits are unweighted and come from moments about the laser's
origin, summed once a run: those of merged runs are sums of theirs, those of trimmed ones lack the
trimmed points', so that no sum is ever larger than its run and none loses digits. They decide
merges and boundaries; the final fit works on residuals and is the maximum likelihood one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from hiermap_cli.perception.beams import concatenated_ranges

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

T = TypeVar("T", bound=np.generic)

GRAZING = 0.01  # cosine of incidence below which a beam is taken to be that steep


class Lines(NamedTuple):
    """K lines in Hesse form about the laser: nx, ny, d, each (K,)."""

    nx: Array
    ny: Array
    d: Array

    def take(self, index: Index | Mask) -> Lines:
        """The lines at `index`."""
        return Lines(self.nx[index], self.ny[index], self.d[index])


def run_moments(x: Array, y: Array, starts: Index) -> Array:
    """Sums of 1, x, y, xx, xy, yy over runs of points that begin at `starts` (K,): (6, K)."""
    out = np.empty((6, len(starts)))
    out[0] = np.diff(starts, append=len(x))
    for row, value in enumerate((x, y, x * x, x * y, y * y), start=1):
        np.add.reduceat(value, starts, out=out[row])
    return out


def inner_moments(x: Array, y: Array, first: Index, last: Index) -> Array:
    """Sums of 1, x, y, xx, xy, yy over points `first` to `last` (inclusive; (K,)): (6, K).

    The runs are apart, in order, and none is empty.
    """
    # What lies between two of these runs is summed up as well, and left out.
    after = last + 1
    apart = np.flatnonzero(np.append(after[:-1] != first[1:], after[-1:] != len(x)))
    bounds = np.insert(first, apart + 1, after.take(apart))
    place = np.arange(len(first))
    place[1:] += np.cumsum(np.bincount(apart, minlength=len(first)))[:-1]
    out = run_moments(x, y, bounds).take(place, axis=1)
    out[0] = after - first
    return out


def few_moments(x: Array, y: Array, take: Mask) -> Array:
    """Sums of 1, x, y, xx, xy, yy over the points (m, K) that `take` (m, K) marks: (6, K)."""
    x, y = x * take, y * take
    return np.stack([v.sum(axis=0) for v in (take, x, y, x * x, x * y, y * y)])


def fit_moments(sums: Array) -> tuple[Lines, Array]:
    """Unweighted total least squares lines of moments (6, K), and their scatter (K,).

    The normal is the axis of the smaller eigenvalue of the scatter matrix, without trigonometry;
    the scatter is that eigenvalue, the sum of squared distances from the line.
    """
    mx, my, half, xy, root, scatter = _principal(sums)
    # The direction of the line is (half + root, xy) or (xy, root - half): the longer one.
    wide = half >= 0.0
    along = np.abs(half) + root
    tx, ty = np.where(wide, along, xy), np.where(wide, xy, along)
    length = np.sqrt(tx * tx + ty * ty)
    length[length == 0.0] = 1.0
    nx, ny = ty / length, -tx / length
    d = nx * mx + ny * my
    sign = np.copysign(1.0, d)
    return Lines(sign * nx, sign * ny, sign * d), scatter


def least_scatter(sums: Array) -> Array:
    """The scatter (K,) of `fit_moments` alone."""
    return _principal(sums)[-1]


def _principal(sums: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Of moments (6, K): mean x and y, half of xx - yy, xy, their norm, the smaller eigenvalue.

    xx, xy and yy are the elements of the scatter matrix about the mean.
    """
    n, sx, sy, sxx, sxy, syy = sums
    mx, my = sx / n, sy / n
    xx, xy, yy = sxx - sx * mx, sxy - sx * my, syy - sy * my
    half = 0.5 * (xx - yy)
    root = np.sqrt(half * half + xy * xy)
    return mx, my, half, xy, root, np.maximum(0.5 * (xx + yy) - root, 0.0)


class Members(NamedTuple):
    """The points of K segments, segment after segment, each in the order of its beams; M in all.

    point: (M,) into the block's points. starts, counts: (K,). ux, uy, r: (M,) unit vectors of the
    points' beams, and their ranges.
    """

    point: Index
    starts: Index
    counts: Index
    ux: Array
    uy: Array
    r: Array

    def of(self, which: Mask) -> tuple[Members, Index]:
        """The members of the segments `which` (K,), and where they stand among these (M,)."""
        counts = self.counts[which]
        here = concatenated_ranges(self.starts[which], counts)
        ux, uy, r = (v.take(here) for v in (self.ux, self.uy, self.r))
        starts = np.cumsum(counts) - counts
        return Members(self.point.take(here), starts, counts, ux, uy, r), here

    def between(self, first: Index, last: Index) -> Mask:
        """True for points `first` to `last` (exclusive; (K,), counted as in `point`) of each."""
        mask = np.zeros(len(self.point) + 1, dtype=np.int8)
        mask[first] = 1
        mask[last] -= 1
        return np.cumsum(mask[:-1], dtype=np.int8).view(np.bool_)

    def spread(self, value: NDArray[T]) -> NDArray[T]:
        """A value of each segment (K,) at each of its points (M,)."""
        return np.repeat(value, self.counts)

    def total(self, value: NDArray[np.generic]) -> NDArray[Any]:
        """The sum of a value of each point (M,) over each segment (K,); a mask is counted."""
        if value.dtype == np.bool_:
            value = value.view(np.int8).astype(np.int64)
        return np.asarray(np.add.reduceat(value, self.starts))


def gather(beams: Beams, index: Index, counts: Index) -> Members:
    """The members `index` (M,) of segments with `counts` (K,) points each, none of them empty."""
    x, y, r = (v.take(index, mode="clip") for v in (beams.x, beams.y, beams.r))
    return Members(index, np.cumsum(counts) - counts, counts, x / r, y / r, r)


class Fit(NamedTuple):
    """Lines after a step of `refine`, their centres and variances.

    cx, cy: (K,) weighted centre. var_alpha, var_d: (K,) variances of the angle and of the offset
    at the centre. residual, variance: (M,) of each point, perpendicular to the fitted line.
    chi2: (K,) weighted sum of squared residuals.
    """

    lines: Lines
    cx: Array
    cy: Array
    var_alpha: Array
    var_d: Array
    residual: Array
    variance: Array
    chi2: Array

    def take(self, index: Index) -> Fit:
        """The fits at `index`; residuals and variances of points are left out."""
        none = np.zeros(0)
        return Fit(
            self.lines.take(index),
            self.cx[index],
            self.cy[index],
            self.var_alpha[index],
            self.var_d[index],
            residual=none,
            variance=none,
            chi2=self.chi2[index],
        )


def refine(
    members: Members,
    lines: Lines,
    laser: LaserConfig,
    keep: Mask | None = None,
    uneven: Array | None = None,
) -> Fit:
    """One Gauss-Newton step of the maximum likelihood fit of ranges along known bearings.

    The noise acts along the beam, so that a point is compared with where its beam meets the line;
    perpendicular to the wall the noise is sigma_r cos(incidence), which must come from the line
    and not from the measured range, or far points pull the line outwards. Seen from the centre
    the residual n . p - d changes by s dalpha - dd when the line turns and moves.

    Args:
        members: the points of each segment.
        lines: (K,) the lines to start from; the step is quadratic, so one from a fit to the same
            points up to noise is enough.
        laser: noise of ranges and bearings.
        keep: (M,) points that count; all if None.
        uneven: (K,) variance of the wall itself, added to that of each point.
    """
    nx, ny = members.spread(lines.nx), members.spread(lines.ny)
    ux, uy = members.ux, members.uy
    cosine = nx * ux
    cosine += ny * uy
    np.maximum(cosine, GRAZING, out=cosine)
    s = nx * uy
    s -= ny * ux  # the beam's component along the wall
    reach = members.spread(lines.d)
    reach /= cosine
    s *= reach
    residual = members.r - reach
    residual *= cosine
    variance = cosine
    if laser.sigma_range_scale or laser.sigma_bearing:
        variance *= laser.sigma_range + laser.sigma_range_scale * reach
        variance *= variance
        variance += (laser.sigma_bearing * s) ** 2
    else:
        variance *= laser.sigma_range
        variance *= variance
    if uneven is not None:
        variance += members.spread(uneven)
    weight = 1.0 / variance
    if keep is not None:
        weight *= keep
    ws, we = weight * s, weight * residual
    W, Ws, We = members.total(weight), members.total(ws), members.total(we)
    Wss, Wes, Wee = members.total(ws * s), members.total(we * s), members.total(we * residual)
    s0, dd = Ws / W, We / W
    Sss = Wss - Ws * s0
    Ses = Wes - We * s0
    turn = -Ses / Sss
    n0x, n0y, d0 = lines
    cx = (d0 + dd) * n0x - s0 * n0y
    cy = (d0 + dd) * n0y + s0 * n0x
    c, sn = np.cos(turn), np.sin(turn)
    n1x, n1y = c * n0x - sn * n0y, sn * n0x + c * n0y
    fitted = Lines(n1x, n1y, n1x * cx + n1y * cy)
    residual += members.spread(turn) * s
    residual -= members.spread(turn * s0 + dd)
    chi2 = np.maximum(Wee - We * dd - Ses * Ses / Sss, 0.0)
    return Fit(fitted, cx, cy, 1.0 / Sss, 1.0 / W, residual, variance, chi2)
