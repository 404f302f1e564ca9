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


class Relocation(NamedTuple):
    """The first step of relocation-fusion: the robot alone corrected from all matches.

    delta_r: (3,) correction of the robot. covariance: (N, N) after it. C: (3, k) = E[e_r v^T],
    the correlation between what remains of the robot's error and the measurement noise.
    """

    delta_r: Array
    covariance: Array
    C: Array


def relocate(P: Array, columns: Index, H_c: Array, R: Array, y: Array) -> Relocation:
    """Correct the robot (the first three components) alone with its rows of the Kalman gain.

    With `K_r` the robot's rows of K and `E = [I_3; 0]`, the remaining error is
    `e' = (I - E K_r H) e - E K_r v`, so `C = E[e' v^T]` has the rows `-K_r R` (Moutarlier and
    Chatila, with the correlation that the naive form drops).
    """
    HP, S = gain(P, columns, H_c, R)
    K_r = np.linalg.solve(S, HP[:, :3]).T
    P_1 = P.copy()
    KHP = K_r @ HP
    P_1[:3] -= KHP
    P_1[:, :3] -= KHP.T
    P_1[:3, :3] += K_r @ S @ K_r.T
    return Relocation(K_r @ y, P_1, -K_r @ R)


def fuse(relocation: Relocation, columns: Index, H_c: Array, R: Array, y: Array) -> Correction:
    """The second step: all objects, with the matches predicted anew at the corrected robot.

    `S = H P H^T + H C + C^T H^T + R`, `K = (P H^T + C) S^-1`. On a linear model the two steps
    give exactly `kalman_update`.
    """
    P, C = relocation.covariance, relocation.C
    HP = H_c @ P[columns]
    robot = columns < 3
    HC = H_c[:, robot] @ C[columns[robot]]
    S = HP[:, columns] @ H_c.T + HC + HC.T + R
    HP[:, :3] += C.T
    L = np.linalg.cholesky(symmetrise(S))
    W = np.linalg.solve(L, HP)
    return Correction(W.T @ np.linalg.solve(L, y), symmetrise(P - W.T @ W))
