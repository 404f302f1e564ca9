"""Conditioning a Gaussian on linear measurements: the algebra that every level shares.

The state's error e ~ N(0, P) of dimension N; a measurement of k rows has the innovation
`y = H e + v` with v ~ N(0, R). What it needs of H are the products `H P` and `S = H P H^T + R`.
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
    """Result of conditioning.

    Mean (N,) of the error, its new covariance (N, N), and the normalised innovation squared `y^T
    S^-1 y`.
    """

    delta: Array
    covariance: Array
    nis: float


class Gain(NamedTuple):
    """What a measurement would do, whitened: with `S = L L^T` its innovation covariance.

    HP: (k, N). S: (k, k). L_inverse: (k, k) lower triangular. W: (k, N) = L^-1 H P, so that
    `K S K^T = W^T W` and `K y = W^T L^-1 y`. The first rows of L^-1 y whiten the first rows of y
    alone, whatever follows them.
    """

    HP: Array
    S: Array
    L_inverse: Array
    W: Array

    def whiten(self, y: Array) -> Array:
        """`L^-1 y` (k,): independent and of unit variance where the filter is consistent."""
        return np.asarray(self.L_inverse @ y)


def symmetrise(P: Array) -> Array:
    """The symmetric part of P."""
    return np.asarray(0.5 * (P + P.T))


def gain(HP: Array, S: Array) -> Gain:
    """The gain of a measurement with noise independent of the state, from `H P` and S."""
    L_inverse = _inverse_factor(S)
    return Gain(HP, S, L_inverse, L_inverse @ HP)


_ENDLESS = 1e300  # over all eigenvalues of an inverse covariance


def _inverse_factor(S: Array) -> Array:
    """`L^-1` of `S = L L^T`, (k, k), by one factorisation.

    The factor of `[[S, 1], [1, c 1]]` has L in its upper left corner and `L^-T` below it; what
    stands to the right of that, where c goes, is not asked for. For the few rows of a scan this
    is faster than a factorisation and an inversion.
    """
    k = len(S)
    both = np.zeros((2 * k, 2 * k))
    both[:k, :k] = S
    flat = both.ravel()
    flat[2 * k * k :: 2 * k + 1] = 1.0
    flat[2 * k * k + k :: 2 * k + 1] = _ENDLESS
    return np.asarray(np.linalg.cholesky(both)[k:, :k].T)


def robot_correction(gain: Gain, y: Array) -> Array:
    """The robot's part (3,) of the Kalman correction: the relocation step."""
    return np.asarray(gain.whiten(y) @ gain.W[:, :3])


def condition(P: Array, gain: Gain, y: Array) -> Correction:
    """The Kalman filter's update: `K = P H^T S^-1`, `delta = K y`, `P - K S K^T`.

    `W^T W` is symmetric to the last bit, so that P stays so.
    """
    z = gain.whiten(y)
    KSK = gain.W.T @ gain.W
    return Correction(z @ gain.W, np.subtract(P, KSK, out=KSK), float(z @ z))
