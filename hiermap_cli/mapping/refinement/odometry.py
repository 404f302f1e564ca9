"""Many odometry increments at once: the model of `estimation.motion`, row by row the same."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.motion import CURVATURE, LASER_X, PARAMETERS, ROTATION_SCALE, SCALE
from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import OdometryConfig

    Array = NDArray[np.float64]


class Motions(NamedTuple):
    """N motions: pose (n, 3), covariance (n, 3, 3) and by_parameters (n, 3, 4) as in `Motion`."""

    pose: Array
    covariance: Array
    by_parameters: Array


def motions(increments: Array, parameters: Array, config: OdometryConfig) -> Motions:
    """The calibrated motions of odometry increments (n, 3)."""
    dx, dy, dtheta = increments.T
    a, b, c, lever = parameters.tolist()
    turn = (1.0 + b) * dtheta + c * dx
    half = 0.5 * (turn - dtheta)
    cos_h, sin_h = np.cos(half), np.sin(half)
    x = (1.0 + a) * (cos_h * dx - sin_h * dy)
    y = (1.0 + a) * (sin_h * dx + cos_h * dy)
    cos_t, sin_t = np.cos(turn), np.sin(turn)
    J = np.zeros((len(dx), 3, PARAMETERS))
    zero = np.zeros_like(dx)
    for k, d_x, d_y, d_turn in (
        (SCALE, x / (1.0 + a), y / (1.0 + a), zero),
        (ROTATION_SCALE, -0.5 * y * dtheta, 0.5 * x * dtheta, dtheta),
        (CURVATURE, -0.5 * y * dx, 0.5 * x * dx, dx),
    ):
        J[:, 0, k] = cos_t * d_x + sin_t * d_y
        J[:, 1, k] = cos_t * d_y - sin_t * d_x
        J[:, 2, k] = d_turn
    J[:, 1] += lever * J[:, 2]
    J[:, 0, LASER_X], J[:, 1, LASER_X] = 1.0 - cos_t, sin_t
    distance, angle = np.hypot(dx, dy), np.abs(dtheta)
    Q = np.zeros((len(dx), 3, 3))
    Q[:, 0, 0] = config.sigma_xy_per_sqrt_m**2 * distance + config.sigma_xy_per_sqrt_rad**2 * angle
    var_t = config.sigma_theta_per_sqrt_m**2 * distance + config.sigma_theta_per_sqrt_rad**2 * angle
    cov = np.copysign(0.5 * var_t * distance, dx)
    Q[:, 1, 1] = Q[:, 0, 0] + var_t * distance**2 / 3.0 + 2.0 * lever * cov + lever**2 * var_t
    Q[:, 1, 2] = Q[:, 2, 1] = cov + lever * var_t
    Q[:, 2, 2] = var_t
    x, y = x + lever * (cos_t - 1.0), y + lever * sin_t
    return Motions(np.column_stack((x, y, se2.wrap(turn))), Q, J)
