"""Straight lines of the plane: Hesse form, g that moves it, and the paper's (p, q, type).

Two forms, both of two parameters, with the leading axes as batch axes:

- Hesse form `(alpha, d)`, shape (..., 2): the points x with cos(alpha) x + sin(alpha) y = d. It
  is oriented: the normal (cos alpha, sin alpha) points to one of the two sides, and
  (alpha + pi, -d) is the same line seen from the other side. It has no singularity.
- The document's `(p, q)`, shape (..., 2), with a `line_type` of the leading axes' shape: type 0
  is x = p y + q, type 1 is y = p x + q (section 4). It is not oriented. p grows without bound
  near the other axis, so that a line is written in the chart with |p| <= 1.

Lines are fitted, moved and fused in Hesse form; (p, q) is what goes out.

A covariance goes with its line through the Jacobian: `C_out = J C J^T`. By sections 3 and 4
`g(R_a_b, S_b)` is `S_a`; section 5.1 prints the pose's inverse in the other place. A line seen by
the robot enters its landmark's frame as `S_l = g(invert(R_r_l), S_r)`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.se2 import wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Types = NDArray[np.int64]


def _matrix(a: Array, b: Array, c: Array, d: Array) -> Array:
    """[[a, b], [c, d]] over broadcast leading axes, shape (..., 2, 2)."""
    a, b, c, d = np.broadcast_arrays(a, b, c, d)
    return np.stack((np.stack((a, b), axis=-1), np.stack((c, d), axis=-1)), axis=-2)


def hesse_from_points(p1: Array, p2: Array) -> Array:
    """The line through two points (..., 2), its normal on the right of p1 -> p2."""
    p1, p2 = np.asarray(p1, dtype=float), np.asarray(p2, dtype=float)
    step = p2 - p1
    alpha = np.arctan2(-step[..., 0], step[..., 1])
    d = np.cos(alpha) * p1[..., 0] + np.sin(alpha) * p1[..., 1]
    return np.stack((alpha, d), axis=-1)


def chart(hesse: Array) -> Types:
    """The `line_type` (...) in which |p| <= 1: 0 where the line is nearer to the y axis."""
    alpha = np.asarray(hesse, dtype=float)[..., 0]
    return np.where(np.abs(np.cos(alpha)) >= np.abs(np.sin(alpha)), 0, 1).astype(np.int64)


def hesse_to_pq(hesse: Array, line_type: Types) -> Array:
    """(p, q) of the line in the chart `line_type`, as `chart` gives it or as another line has."""
    hesse = np.asarray(hesse, dtype=float)
    first = np.asarray(line_type) == 0
    c, s = np.cos(hesse[..., 0]), np.sin(hesse[..., 0])
    on, across = np.where(first, c, s), np.where(first, s, c)
    return np.stack((-across / on, hesse[..., 1] / on), axis=-1)


def hesse_to_pq_D_hesse(hesse: Array, line_type: Types) -> Array:
    """d (p, q) / d (alpha, d), shape (..., 2, 2)."""
    hesse = np.asarray(hesse, dtype=float)
    first = np.asarray(line_type) == 0
    c, s = np.cos(hesse[..., 0]), np.sin(hesse[..., 0])
    on, across = np.where(first, c, s), np.where(first, s, c)
    sign = np.where(first, 1.0, -1.0)
    turn = sign / (on * on)
    return _matrix(-turn, np.zeros_like(on), turn * across * hesse[..., 1], 1.0 / on)


def g_hesse(R_a_b: Array, S_b: Array) -> Array:
    """The paper's g in Hesse form: the line `S_a`, shape (..., 2), of `S_b` and `R_a_b`."""
    R_a_b, S_b = np.asarray(R_a_b, dtype=float), np.asarray(S_b, dtype=float)
    alpha = S_b[..., 0] + R_a_b[..., 2]
    d = S_b[..., 1] + np.cos(alpha) * R_a_b[..., 0] + np.sin(alpha) * R_a_b[..., 1]
    return np.stack((wrap(alpha), d), axis=-1)


def _lever(R_a_b: Array, S_b: Array) -> tuple[Array, Array, Array]:
    """cos and sin of the line's angle in a, and how far b's origin lies along the line."""
    R_a_b, S_b = np.asarray(R_a_b, dtype=float), np.asarray(S_b, dtype=float)
    alpha = S_b[..., 0] + R_a_b[..., 2]
    c, s = np.cos(alpha), np.sin(alpha)
    return c, s, c * R_a_b[..., 1] - s * R_a_b[..., 0]


def g_hesse_D_pose(R_a_b: Array, S_b: Array) -> Array:
    """d g_hesse / d R_a_b, shape (..., 2, 3)."""
    c, s, lever = _lever(R_a_b, S_b)
    J = np.zeros((*c.shape, 2, 3))
    J[..., 0, 2] = 1.0
    J[..., 1, 0], J[..., 1, 1], J[..., 1, 2] = c, s, lever
    return J


def g_hesse_D_line(R_a_b: Array, S_b: Array) -> Array:
    """d g_hesse / d S_b, shape (..., 2, 2)."""
    c, _, lever = _lever(R_a_b, S_b)
    return _matrix(np.ones_like(c), np.zeros_like(c), lever, np.ones_like(c))


def hesse_D_centred(alpha: Array, centre: Array) -> Array:
    """d (alpha, d) / d (alpha, d_c), shape (..., 2, 2), of a line through `centre` (..., 2).

    d_c is the offset along the normal at the centre, as `SegmentBlock.covariance` has it; the
    covariance about the frame's origin is J C J^T.
    """
    alpha, centre = np.asarray(alpha, dtype=float), np.asarray(centre, dtype=float)
    lever = np.cos(alpha) * centre[..., 1] - np.sin(alpha) * centre[..., 0]
    one = np.ones_like(lever)
    return _matrix(one, np.zeros_like(lever), lever, one)


def intersect(first: Array, second: Array) -> Array:
    """The point (..., 2) where two lines in Hesse form meet; they must not be parallel."""
    first, second = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    c1, s1, d1 = np.cos(first[..., 0]), np.sin(first[..., 0]), first[..., 1]
    c2, s2, d2 = np.cos(second[..., 0]), np.sin(second[..., 0]), second[..., 1]
    sine = c1 * s2 - s1 * c2
    return np.stack(((d1 * s2 - d2 * s1) / sine, (d2 * c1 - d1 * c2) / sine), axis=-1)


def intersect_D_lines(first: Array, second: Array) -> Array:
    """d intersect / d (alpha1, d1, alpha2, d2), shape (..., 2, 4).

    The point is on both lines: n_i . P = d_i, so that n_i . dP = dd_i - (t_i . P) dalpha_i with
    t_i the normal turned by a right angle.
    """
    first, second = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    P = intersect(first, second)
    c1, s1 = np.cos(first[..., 0]), np.sin(first[..., 0])
    c2, s2 = np.cos(second[..., 0]), np.sin(second[..., 0])
    sine = c1 * s2 - s1 * c2
    along1 = c1 * P[..., 1] - s1 * P[..., 0]
    along2 = c2 * P[..., 1] - s2 * P[..., 0]
    J = np.empty((*sine.shape, 2, 4))
    J[..., 0, 0], J[..., 0, 1] = -along1 * s2 / sine, s2 / sine
    J[..., 0, 2], J[..., 0, 3] = along2 * s1 / sine, -s1 / sine
    J[..., 1, 0], J[..., 1, 1] = along1 * c2 / sine, -c2 / sine
    J[..., 1, 2], J[..., 1, 3] = -along2 * c1 / sine, c1 / sine
    return J
