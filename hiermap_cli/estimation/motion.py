"""The odometry model: what a wheel increment says of the robot's motion, and how well.

Besides noise, odometry has faults that stay: its scale, the scale of its rotations, and a
heading drift proportional to the distance. They, and the laser's x offset on the robot, are
parameters in the state, `[scale, rotation_scale, curvature, laser_x]`, all zero when nothing
is wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.estimation.stochastic_map import Motion
from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import OdometryConfig

    Array = NDArray[np.float64]

SCALE, ROTATION_SCALE, CURVATURE, LASER_X = range(4)
PARAMETERS = 4


def prior_covariance(config: OdometryConfig) -> Array:
    """Prior covariance (4, 4) of the parameters, before any scan was seen."""
    return np.diag(
        np.square(
            [
                config.prior_scale,
                config.prior_rotation_scale,
                config.prior_curvature,
                config.prior_laser_x,
            ]
        )
    )


def motion(increment: Array, parameters: Array, config: OdometryConfig) -> Motion:
    """The calibrated motion of one odometry increment `[dx, dy, dtheta]` (robot's frame).

    With ds = dx (signed: backing up unwinds the drift) the heading turns by
    `(1 + b) dtheta + c ds`, and the chord is turned by half of what this adds. The noise is a
    random walk: variances grow with distance and angle, so that cutting a motion into steps
    changes nothing.
    """
    dx, dy, dtheta = (float(v) for v in increment)
    a, b, c = (float(v) for v in parameters[:3])
    turn = (1.0 + b) * dtheta + c * dx
    half = 0.5 * (turn - dtheta)
    cos_h, sin_h = np.cos(half), np.sin(half)
    x = (1.0 + a) * (cos_h * dx - sin_h * dy)
    y = (1.0 + a) * (sin_h * dx + cos_h * dy)

    # d (x, y, turn) / d (a, b, c), then turned into the frame after the motion.
    J = np.zeros((3, PARAMETERS))
    J[0, SCALE], J[1, SCALE] = x / (1.0 + a), y / (1.0 + a)
    for k, d_turn in ((ROTATION_SCALE, dtheta), (CURVATURE, dx)):
        J[0, k], J[1, k], J[2, k] = -0.5 * y * d_turn, 0.5 * x * d_turn, d_turn
    cos_t, sin_t = np.cos(turn), np.sin(turn)
    J[:2] = np.array([[cos_t, sin_t], [-sin_t, cos_t]]) @ J[:2]

    distance, angle = float(np.hypot(dx, dy)), abs(dtheta)
    var_x = config.sigma_xy_per_sqrt_m**2 * distance + config.sigma_xy_per_sqrt_rad**2 * angle
    var_t = config.sigma_theta_per_sqrt_m**2 * distance + config.sigma_theta_per_sqrt_rad**2 * angle
    Q = np.diag([var_x, var_x, var_t])
    # Heading noise gathered along the way moves the end point sideways: a third of the variance
    # at full lever arm, correlated by a half (a random walk integrated once).
    Q[1, 1] += var_t * distance**2 / 3.0
    Q[1, 2] = Q[2, 1] = 0.5 * var_t * distance * np.sign(dx)
    return Motion(np.array([x, y, se2.wrap_one(turn)]), Q, J)


def distrusted(motion: Motion, config: OdometryConfig) -> Motion:
    """The motion of an increment that cannot be true.

    It says little, and nothing of the calibration.
    """
    spread = np.diag(
        np.square([config.fault_sigma_xy, config.fault_sigma_xy, config.fault_sigma_theta])
    )
    return Motion(motion.pose, motion.covariance + spread, np.zeros_like(motion.by_parameters))
