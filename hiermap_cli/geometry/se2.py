"""Poses of the plane: the group SE(2), its algebra and its Jacobians.

A pose is an array of shape (..., 3), `[x, y, theta]` in metres and radians; the leading axes
are batch axes. `R_a_b` is frame b seen from frame a, so that `R_a_c = compose(R_a_b, R_b_c)`
cancels. A tangent vector is `[rho_x, rho_y, phi]`, in the same order. A Jacobian `out_D_in` is
taken in additive coordinates unless its name says otherwise.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

IDENTITY = np.zeros(3)
IDENTITY.flags.writeable = False


def wrap(angle: Array) -> Array:
    """Angles wrapped to (-pi, pi]."""
    return np.pi - np.mod(np.pi - np.asarray(angle), 2.0 * np.pi)


def wrap_one(angle: float) -> float:
    """One angle wrapped to (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def compose(R_a_b: Array, R_b_c: Array) -> Array:
    """The paper's f (equation 1): `R_a_c`, shape (..., 3)."""
    R_a_b, R_b_c = np.asarray(R_a_b, dtype=float), np.asarray(R_b_c, dtype=float)
    if R_a_b.ndim == R_b_c.ndim == 1:
        return _compose_one(R_a_b, R_b_c)
    c, s = np.cos(R_a_b[..., 2]), np.sin(R_a_b[..., 2])
    x, y = R_b_c[..., 0], R_b_c[..., 1]
    # A single pose before many needs no broadcasting worked out, which costs as much as the rest.
    single = R_a_b.ndim == 1
    out = np.empty(R_b_c.shape if single else np.broadcast_shapes(R_a_b.shape, R_b_c.shape))
    out[..., 0] = R_a_b[..., 0] + c * x - s * y
    out[..., 1] = R_a_b[..., 1] + s * x + c * y
    out[..., 2] = wrap(R_a_b[..., 2] + R_b_c[..., 2])
    return out


def _compose_one(R_a_b: Array, R_b_c: Array) -> Array:
    """`compose` of two single poses, without the cost of array operations."""
    x_a, y_a, theta_a = R_a_b.tolist()
    x, y, theta = R_b_c.tolist()
    c, s = math.cos(theta_a), math.sin(theta_a)
    return np.array((x_a + c * x - s * y, y_a + s * x + c * y, wrap_one(theta_a + theta)))


def invert(R_a_b: Array) -> Array:
    """`R_b_a`, shape (..., 3)."""
    R_a_b = np.asarray(R_a_b, dtype=float)
    if R_a_b.ndim == 1:
        x_a, y_a, theta = R_a_b.tolist()
        cos, sin = math.cos(theta), math.sin(theta)
        return np.array((-cos * x_a - sin * y_a, sin * x_a - cos * y_a, wrap_one(-theta)))
    c, s = np.cos(R_a_b[..., 2]), np.sin(R_a_b[..., 2])
    x, y = R_a_b[..., 0], R_a_b[..., 1]
    out = np.empty(R_a_b.shape)
    out[..., 0] = -c * x - s * y
    out[..., 1] = s * x - c * y
    out[..., 2] = wrap(-R_a_b[..., 2])
    return out


def between(R_g_a: Array, R_g_b: Array) -> Array:
    """`R_a_b` of two poses known in one frame: `compose(invert(R_g_a), R_g_b)`."""
    R_g_a, R_g_b = np.asarray(R_g_a, dtype=float), np.asarray(R_g_b, dtype=float)
    if R_g_a.ndim == R_g_b.ndim == 1:
        x_a, y_a, theta_a = R_g_a.tolist()
        x_b, y_b, theta_b = R_g_b.tolist()
        cos, sin = math.cos(theta_a), math.sin(theta_a)
        dx, dy = x_b - x_a, y_b - y_a
        return np.array((cos * dx + sin * dy, cos * dy - sin * dx, wrap_one(theta_b - theta_a)))
    c, s = np.cos(R_g_a[..., 2]), np.sin(R_g_a[..., 2])
    x, y = R_g_b[..., 0] - R_g_a[..., 0], R_g_b[..., 1] - R_g_a[..., 1]
    out = np.empty(np.broadcast_shapes(R_g_a.shape, R_g_b.shape))
    out[..., 0] = c * x + s * y
    out[..., 1] = c * y - s * x
    out[..., 2] = wrap(R_g_b[..., 2] - R_g_a[..., 2])
    return out


def rotation(theta: Array) -> Array:
    """Rotation matrices, shape (..., 2, 2)."""
    theta = np.asarray(theta, dtype=float)
    c, s = np.cos(theta), np.sin(theta)
    out = np.empty((*theta.shape, 2, 2))
    out[..., 0, 0] = out[..., 1, 1] = c
    out[..., 0, 1], out[..., 1, 0] = -s, s
    return out


def compose_D_first(R_a_b: Array, R_b_c: Array) -> Array:
    """`J1` of section 3.1: d compose / d R_a_b, shape (..., 3, 3)."""
    R_a_b, R_b_c = np.asarray(R_a_b, dtype=float), np.asarray(R_b_c, dtype=float)
    c, s = np.cos(R_a_b[..., 2]), np.sin(R_a_b[..., 2])
    x, y = R_b_c[..., 0], R_b_c[..., 1]
    J = np.zeros((*np.broadcast_shapes(R_a_b.shape, R_b_c.shape)[:-1], 3, 3))
    J[..., 0, 0] = J[..., 1, 1] = J[..., 2, 2] = 1.0
    J[..., 0, 2] = -s * x - c * y
    J[..., 1, 2] = c * x - s * y
    return J


def compose_D_second(R_a_b: Array, R_b_c: Array) -> Array:
    """`J2` of section 3.1: d compose / d R_b_c, shape (..., 3, 3)."""
    R_a_b, R_b_c = np.asarray(R_a_b, dtype=float), np.asarray(R_b_c, dtype=float)
    J = np.zeros((*np.broadcast_shapes(R_a_b.shape, R_b_c.shape)[:-1], 3, 3))
    J[..., :2, :2] = rotation(R_a_b[..., 2])
    J[..., 2, 2] = 1.0
    return J


def invert_D_pose(R_a_b: Array) -> Array:
    """d invert / d R_a_b, shape (..., 3, 3)."""
    R_a_b = np.asarray(R_a_b, dtype=float)
    c, s = np.cos(R_a_b[..., 2]), np.sin(R_a_b[..., 2])
    x, y = R_a_b[..., 0], R_a_b[..., 1]
    J = np.zeros((*R_a_b.shape, 3))
    J[..., 0, 0], J[..., 0, 1], J[..., 0, 2] = -c, -s, s * x - c * y
    J[..., 1, 0], J[..., 1, 1], J[..., 1, 2] = s, -c, c * x + s * y
    J[..., 2, 2] = -1.0
    return J


def _sinc(x: Array) -> Array:
    """sin(x) / x, one at zero."""
    x = np.where(np.abs(x) < 1e-9, 1e-9, x)
    return np.asarray(np.sin(x) / x)


def _sinc_one(x: float) -> float:
    return math.sin(x) / x if abs(x) > 1e-9 else 1.0


def exp(tangent: Array) -> Array:
    """The exponential map: tangent (..., 3) to pose (..., 3)."""
    tangent = np.asarray(tangent, dtype=float)
    if tangent.ndim == 1:
        x, y, angle = tangent.tolist()
        sine, half_sine = _sinc_one(angle), _sinc_one(0.5 * angle)
        rest = 0.5 * angle * half_sine * half_sine
        return np.array((sine * x - rest * y, rest * x + sine * y, wrap_one(angle)))
    rho_x, rho_y, phi = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    a = _sinc(phi)
    b = 0.5 * phi * _sinc(0.5 * phi) ** 2  # (1 - cos(phi)) / phi
    out = np.empty(tangent.shape)
    out[..., 0] = a * rho_x - b * rho_y
    out[..., 1] = b * rho_x + a * rho_y
    out[..., 2] = wrap(phi)
    return out


def moved(R_a_b: Array, tangent: Array) -> Array:
    """`compose(exp(tangent), R_a_b)` of many poses, (n, 3) both: a step of their global errors.

    In complex numbers, where a rotation is a product: with `h = exp(i phi / 2)` the point z goes
    to `h^2 z + h sinc(phi / 2) rho`. It takes less than half of the array operations.
    """
    # The smallest of numbers, lost in any angle but zero, makes sin(0) / 0 one.
    half = 0.5 * tangent[:, 2] + 1e-300
    h = np.empty(len(half), dtype=np.complex128)
    np.cos(half, out=h.real)
    np.sin(half, out=h.imag)
    out = np.empty(R_a_b.shape)
    z, rho, moved = (pose[:, :2].view(np.complex128)[:, 0] for pose in (R_a_b, tangent, out))
    np.multiply(h, h * z + (h.imag / half) * rho, out=moved)
    out[:, 2] = wrap(R_a_b[:, 2] + tangent[:, 2])
    return out


def log(R_a_b: Array) -> Array:
    """The logarithm: pose (..., 3) to tangent (..., 3), its angle in (-pi, pi]."""
    R_a_b = np.asarray(R_a_b, dtype=float)
    if R_a_b.ndim == 1:
        x_b, y_b, angle = R_a_b.tolist()
        angle = wrap_one(angle)
        scale = _sinc_one(angle) / _sinc_one(0.5 * angle) ** 2
        turn = 0.5 * angle
        return np.array((scale * x_b + turn * y_b, scale * y_b - turn * x_b, angle))
    phi = wrap(R_a_b[..., 2])
    half = 0.5 * phi
    # half / tan(half) is smooth at zero; at |phi| = pi it is zero.
    a = _sinc(phi) / _sinc(half) ** 2
    x, y = R_a_b[..., 0], R_a_b[..., 1]
    out = np.empty(R_a_b.shape)
    out[..., 0] = a * x + half * y
    out[..., 1] = -half * x + a * y
    out[..., 2] = phi
    return out


def adjoint(R_a_b: Array) -> Array:
    """`Ad(X)`, shape (..., 3, 3), with `X exp(tau) = exp(Ad(X) tau) X`."""
    R_a_b = np.asarray(R_a_b, dtype=float)
    if R_a_b.ndim == 1:
        x, y, theta = R_a_b.tolist()
        c, s = math.cos(theta), math.sin(theta)
        return np.array(((c, -s, y), (s, c, -x), (0.0, 0.0, 1.0)))
    Ad = np.zeros((*R_a_b.shape, 3))
    theta = R_a_b[..., 2]
    Ad[..., 0, 0] = Ad[..., 1, 1] = np.cos(theta)
    Ad[..., 1, 0] = sin = np.sin(theta)
    np.negative(sin, out=Ad[..., 0, 1])
    Ad[..., 0, 2] = R_a_b[..., 1]
    np.negative(R_a_b[..., 0], out=Ad[..., 1, 2])
    Ad[..., 2, 2] = 1.0
    return Ad


def additive_D_invariant(R_a_b: Array) -> Array:
    """d (x, y, theta) / d delta at `X = exp(delta) X_hat`, shape (..., 3, 3).

    Turns a covariance of the global, left-multiplied error into one of the additive error.
    """
    R_a_b = np.asarray(R_a_b, dtype=float)
    J = np.zeros((*R_a_b.shape, 3))
    J[..., 0, 0] = J[..., 1, 1] = J[..., 2, 2] = 1.0
    J[..., 0, 2] = -R_a_b[..., 1]
    J[..., 1, 2] = R_a_b[..., 0]
    return J


def invariant_D_additive(R_a_b: Array) -> Array:
    """The inverse of `additive_D_invariant`, shape (..., 3, 3)."""
    J = additive_D_invariant(R_a_b)
    J[..., :2, 2] *= -1.0
    return J


def interpolate(R_g_a: Array, R_g_b: Array, fraction: Array) -> Array:
    """Linear in the position, along the shortest arc in the heading; `fraction` in [0, 1]."""
    R_g_a, R_g_b = np.asarray(R_g_a, dtype=float), np.asarray(R_g_b, dtype=float)
    step = R_g_b - R_g_a
    step[..., 2] = wrap(step[..., 2])
    out = R_g_a + np.asarray(fraction)[..., None] * step
    out[..., 2] = wrap(out[..., 2])
    return out
