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
    """Result of conditioning: mean (N,) of the error, its new covariance (N, N), and the
    normalised innovation squared `y^T S^-1 y`."""

    delta: Array
    covariance: Array
    nis: float


class Gain(NamedTuple):
    """What a measurement would do: `HP` (k, N), innovation covariance S (k, k)."""

    HP: Array
    S: Array

    def select(self, rows: Index) -> Gain:
        """The same for some of the rows."""
        return Gain(self.HP[rows], self.S[rows[:, None], rows])


def symmetrise(P: Array) -> Array:
    """The symmetric part of P."""
    return 0.5 * (P + P.T)


def gain(P: Array, columns: Index, H_c: Array, R: Array) -> Gain:
    """`HP` and `S = H P H^T + R` of a measurement with noise independent of the state."""
    HP = H_c @ P[columns]
    return Gain(HP, HP[:, columns] @ H_c.T + R)


def robot_correction(gain: Gain, y: Array) -> Array:
    """The robot's part (3,) of the Kalman correction: the relocation step."""
    return np.asarray(gain.HP[:, :3].T @ np.linalg.solve(gain.S, y))


def condition(P: Array, gain: Gain, y: Array) -> Correction:
    """The Kalman filter's update: `K = P H^T S^-1`, `delta = K y`, `P - K S K^T`.

    `K S K^T = W^T W` with `W = L^-1 H P`, whose product with its own transpose is symmetric to
    the last bit, so that P stays so.
    """
    k = len(y)
    L = np.linalg.cholesky(symmetrise(gain.S))
    solved = np.linalg.solve(L, np.concatenate((gain.HP, y[:, None]), axis=1))
    W, z = np.ascontiguousarray(solved[:, :-1]), solved[:, -1]
    assert len(W) == k
    return Correction(W.T @ z, P - W.T @ W, float(z @ z))
