"""The odometry model: what a wheel increment says of the robot's motion, and how well.

Besides noise, odometry has faults that stay: its scale, the scale of its rotations, and a
heading drift proportional to the distance. They, and the laser's x offset on the robot, are
parameters in the state, `[scale, rotation_scale, curvature, laser_x]`, all zero when nothing
is wrong.

The robot's frame is the one from which the log's mount leads to the laser: a scan placed with
that mount lies right. As far as the mount is wrong, it is the point about which odometry turns
that lies elsewhere: `laser_x` behind the frame's origin.
"""

from __future__ import annotations

import math
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
    """The calibrated motion of one odometry increment `[dx, dy, dtheta]`.

    With ds = dx (signed: backing up unwinds the drift) the heading turns by
    `(1 + b) dtheta + c ds`, and the chord is turned by half of what this adds. The noise is a
    random walk: variances grow with distance and angle, so that cutting a motion into steps
    changes nothing.
    """
    dx, dy, dtheta = increment.tolist()
    a, b, c, lever = parameters.tolist()
    turn = (1.0 + b) * dtheta + c * dx
    half = 0.5 * (turn - dtheta)
    cos_h, sin_h = math.cos(half), math.sin(half)
    x = (1.0 + a) * (cos_h * dx - sin_h * dy)
    y = (1.0 + a) * (sin_h * dx + cos_h * dy)

    # d (x, y, turn) / d parameters, turned into the frame after the motion. `LASER_X`, the last
    # one, is no column: it is told in that frame.
    cos_t, sin_t = math.cos(turn), math.sin(turn)
    columns = (
        (x / (1.0 + a), y / (1.0 + a), 0.0),
        (-0.5 * y * dtheta, 0.5 * x * dtheta, dtheta),
        (-0.5 * y * dx, 0.5 * x * dx, dx),
    )
    # Of the point about which odometry turns; the robot's origin is `lever` ahead of it.
    J = np.array(
        [
            [cos_t * d_x + sin_t * d_y for d_x, d_y, _ in columns] + [1.0 - cos_t],
            [cos_t * d_y - sin_t * d_x + lever * d_turn for d_x, d_y, d_turn in columns] + [sin_t],
            [d_turn for _, _, d_turn in columns] + [0.0],
        ]
    )

    distance, angle = math.hypot(dx, dy), abs(dtheta)
    var_x = config.sigma_xy_per_sqrt_m**2 * distance + config.sigma_xy_per_sqrt_rad**2 * angle
    var_t = config.sigma_theta_per_sqrt_m**2 * distance + config.sigma_theta_per_sqrt_rad**2 * angle
    # Heading noise gathered along the way moves the end point sideways: a third of the variance
    # at full lever arm, correlated by a half (a random walk integrated once).
    var_y = var_x + var_t * distance**2 / 3.0
    cov = math.copysign(0.5 * var_t * distance, dx)
    var_y += 2.0 * lever * cov + lever**2 * var_t
    cov += lever * var_t
    x, y = x + lever * (cos_t - 1.0), y + lever * sin_t
    Q = np.array([[var_x, 0.0, 0.0], [0.0, var_y, cov], [0.0, cov, var_t]])
    return Motion(np.array([x, y, se2.wrap_one(turn)]), Q, J)


def distrusted(motion: Motion, config: OdometryConfig) -> Motion:
    """The motion of an increment that cannot be true.

    It says little, and nothing of the calibration.
    """
    spread = np.diag(
        np.square([config.fault_sigma_xy, config.fault_sigma_xy, config.fault_sigma_theta])
    )
    return Motion(motion.pose, motion.covariance + spread, np.zeros_like(motion.by_parameters))
