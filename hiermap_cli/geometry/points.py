"""Points of the plane seen from different frames: the paper's h and its Jacobians.

A point is an array of shape (..., 2), `P_a` seen from frame a; the leading axes broadcast against
those of the pose. `h(R_a_b, P_b)` is `P_a`, as g is for lines (sections 3.1 and 5.1).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.se2 import rotation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def planar(points: Array) -> NDArray[np.complex128]:
    """The first two of the last axis as complex numbers `x + i y`, (...,): a view, not a copy.

    Raises ValueError where the last axis is not contiguous in memory.
    """
    return np.asarray(points[..., :2].view(np.complex128)[..., 0])


def turning(theta: Array) -> NDArray[np.complex128]:
    """`exp(i theta)` as complex numbers, (n,): multiplied with a point they turn it."""
    out = np.empty(len(theta), dtype=np.complex128)
    np.cos(theta, out=out.real)
    np.sin(theta, out=out.imag)
    return out


def h(R_a_b: Array, P_b: Array) -> Array:
    """The point seen from a, shape (..., 2), of its position in b and of b seen from a."""
    R_a_b, P_b = np.asarray(R_a_b, dtype=float), np.asarray(P_b, dtype=float)
    c, s = np.cos(R_a_b[..., 2]), np.sin(R_a_b[..., 2])
    x, y = P_b[..., 0], P_b[..., 1]
    return np.stack((R_a_b[..., 0] + c * x - s * y, R_a_b[..., 1] + s * x + c * y), axis=-1)


def h_D_pose(R_a_b: Array, P_b: Array) -> Array:
    """d h / d R_a_b, shape (..., 2, 3)."""
    R_a_b, P_b = np.asarray(R_a_b, dtype=float), np.asarray(P_b, dtype=float)
    c, s = np.cos(R_a_b[..., 2]), np.sin(R_a_b[..., 2])
    x, y = P_b[..., 0], P_b[..., 1]
    J = np.zeros((*np.broadcast_shapes(R_a_b.shape[:-1], P_b.shape[:-1]), 2, 3))
    J[..., 0, 0] = J[..., 1, 1] = 1.0
    J[..., 0, 2] = -s * x - c * y
    J[..., 1, 2] = c * x - s * y
    return J


def h_D_point(R_a_b: Array, P_b: Array) -> Array:
    """d h / d P_b, shape (..., 2, 2): the rotation of b seen from a."""
    R_a_b, P_b = np.asarray(R_a_b, dtype=float), np.asarray(P_b, dtype=float)
    shape = np.broadcast_shapes(R_a_b.shape[:-1], P_b.shape[:-1])
    return np.array(np.broadcast_to(rotation(R_a_b[..., 2]), (*shape, 2, 2)))
