"""How far a mean of normalised squares may lie from one by chance alone.

The mean of n independent NEES or NIS values of d degrees each is chi-square of n d degrees over
n d (Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
5.4). Errors of one run are not independent: n is replaced by how many independent values tell as
much. Of a Gaussian sequence with autocorrelation r(k) the squares have r(k)^2, so that their
mean has the variance of n / tau values with `tau = 1 + 2 sum r(k)^2`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_NORMAL_95 = 1.959963984540054


class Band(NamedTuple):
    """Where a mean of normalised squares lies 95 times in 100 if covariances are true.

    independent: the number of values that are as good as independent.
    """

    low: float
    high: float
    independent: float


def band(degrees: float, independent: float) -> Band:
    """The band of the mean over values of `degrees` each, `independent` of them.

    By the cube root transform of Wilson and Hilferty, good to a percent from three degrees on.
    """
    k = max(degrees * independent, 1.0)
    spread = _NORMAL_95 * math.sqrt(2.0 / (9.0 * k))
    middle = 1.0 - 2.0 / (9.0 * k)
    return Band(max(middle - spread, 0.0) ** 3, (middle + spread) ** 3, independent)


def independent_of_sequence(whitened: Array) -> float:
    """How many of a sequence's values (n, d), whitened by their covariances, are independent.

    The autocorrelation is taken about zero, which the errors' mean must be, and summed up to where
    it first falls below what chance gives; at least one value is independent.
    """
    n = len(whitened)
    if n < 2:
        return float(n)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(whitened, size, axis=0)
    power = np.fft.irfft((np.abs(spectrum) ** 2).sum(axis=1), size)[:n]
    if power[0] <= 0.0:
        return 1.0
    r = power / power[0]
    below = np.flatnonzero(r < _NORMAL_95 / math.sqrt(n * whitened.shape[1]))
    end = int(below[0]) if len(below) else n
    tau = 1.0 + 2.0 * float((r[1:end] ** 2).sum())
    return max(1.0, n / tau)


def independent_of_chain(n: float, lag1: float) -> float:
    """The same of n values of which only the correlation of neighbours is known, r(k) = lag1^k."""
    square = min(lag1 * lag1, 0.999)
    return max(1.0, n * (1.0 - square) / (1.0 + square))


def independent_of_groups(shares: list[Array]) -> float:
    """The same of groups of values, each with the share (m,) of variance it has in common.

    Two of one group are correlated by the root of the product of their shares.
    """
    total = 0.0
    for share in shares:
        correlation = np.sqrt(np.outer(share, share))
        np.fill_diagonal(correlation, 1.0)
        total += len(share) ** 2 / float((correlation**2).sum())
    return max(1.0, total)
