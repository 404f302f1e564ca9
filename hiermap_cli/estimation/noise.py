"""How large the noise of this log is, by the filter's own innovations.

The sensor's noise is known; how uneven the building's walls are, and how badly this robot's
wheels slip, is not. A consistent update has a NIS of one a degree of freedom, and it falls into
two independent parts: the robot's correction `delta_r = K_r y`, whose covariance is by how much
the robot's covariance shrinks (3 degrees: is the odometry as good as said?), and the rest (k - 3
degrees: do the walls lie where they were?). Each scales its own variance, a little at a time,
until its part is one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry.median import median

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import NoiseConfig

    Array = NDArray[np.float64]

LEAST_ROWS = 8  # of an update that may tell
LEAST_DEGREES, LEAST_FITS = 8, 20  # of fits that may tell the laser's noise
WORST = 3.0  # a single scan counts as no worse: outliers are not noise


class NoiseScale(NamedTuple):
    """Factors on variances: of the odometry's noise, the walls' unevenness, the laser's noise."""

    odometry: float = 1.0
    walls: float = 1.0
    laser: float = 1.0


class Surprise(NamedTuple):
    """The NIS of an update in its two parts, each over its degrees of freedom."""

    robot: float
    rest: float


def surprise(nis: float, rows: int, delta_r: Array, shrunk: Array) -> Surprise:
    """Splits a NIS.

    Delta_r: (3,) the robot's correction; shrunk: (3, 3) the robot's covariance before the update
    minus after it, in the same coordinates.
    """
    robot = min(max(_mahalanobis3(delta_r.tolist(), shrunk.tolist()), 0.0), nis)
    return Surprise(robot / 3.0, (nis - robot) / (rows - 3))


def _mahalanobis3(d: list[float], D: list[list[float]]) -> float:
    """`d^T D^-1 d` in three dimensions, by elimination; a direction of no variance tells nothing.

    Written out: this small a system is solved faster than an array function is called.
    """
    total = 0.0
    floor = [1e-9 * D[i][i] + 1e-18 for i in range(3)]
    for i in range(3):
        pivot = D[i][i]
        if pivot <= floor[i]:
            continue
        total += d[i] * d[i] / pivot
        for j in range(i + 1, 3):
            factor = D[j][i] / pivot
            d[j] -= factor * d[i]
            for k in range(i + 1, 3):
                D[j][k] -= factor * D[i][k]
    return total


def adapted(scale: NoiseScale, seen: Surprise, rate: float, config: NoiseConfig) -> NoiseScale:
    """The factors moved by one update: up where it surprises, down where it does not."""
    return scale._replace(
        odometry=_moved(scale.odometry, seen.robot, rate, config.odometry_range),
        walls=_moved(scale.walls, seen.rest, rate, config.walls_range),
    )


def residual_factor(chi2: Array, degrees: NDArray[np.int64], config: NoiseConfig) -> float:
    """The factor on the laser's variance by which line fits have the residuals they should.

    chi2: (S,) of each fit, degrees: (S,) of freedom. The median over the fits of many points: a
    wall that is no line counts for no more than any other.
    """
    many = degrees >= LEAST_DEGREES
    if np.count_nonzero(many) < LEAST_FITS:
        return 1.0
    factor = float(median(chi2[many] / degrees[many]))
    return min(max(factor, config.laser_range[0]), config.laser_range[1])


def _moved(factor: float, ratio: float, rate: float, bounds: tuple[float, float]) -> float:
    factor *= math.exp(rate * (min(ratio, WORST) - 1.0))
    return min(max(factor, bounds[0]), bounds[1])
