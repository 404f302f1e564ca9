"""Conditioning a Gaussian on linear measurements: the algebra that every level shares.

The state's error e ~ N(0, P) of dimension N; a measurement of k rows has the innovation
`y = H e + v` with v ~ N(0, R). H is given by its non-zero columns: `H[:, columns] = H_c`.
Only the innovation covariance S is ever factored, so that components known exactly (zero rows
of P) do no harm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


class Correction(NamedTuple):
    """Result of conditioning: mean (N,) of the error, and its new covariance (N, N)."""

    delta: Array
    covariance: Array


class Gain(NamedTuple):
    """What a measurement would do: `HP` (k, N), innovation covariance S (k, k)."""

    HP: Array
    S: Array


def symmetrise(P: Array) -> Array:
    """The symmetric part of P."""
    return 0.5 * (P + P.T)


def gain(P: Array, columns: Index, H_c: Array, R: Array) -> Gain:
    """`HP` and `S = H P H^T + R` of a measurement with noise independent of the state."""
    HP = H_c @ P[columns]
    return Gain(HP, HP[:, columns] @ H_c.T + R)


def kalman_update(P: Array, columns: Index, H_c: Array, R: Array, y: Array) -> Correction:
    """The Kalman filter's update: `K = P H^T S^-1`, `delta = K y`, `P - K S K^T`."""
    HP, S = gain(P, columns, H_c, R)
    L = np.linalg.cholesky(S)
    W = np.linalg.solve(L, HP)  # K S K^T = W^T W
    return Correction(W.T @ np.linalg.solve(L, y), symmetrise(P - W.T @ W))


def robot_correction(P: Array, columns: Index, H_c: Array, R: Array, y: Array) -> Array:
    """The robot's part (3,) of the Kalman correction: the relocation step."""
    HP, S = gain(P, columns, H_c, R)
    return HP[:, :3].T @ np.linalg.solve(S, y)
