"""What the wheels say: increments of the true motion with noise, constant faults and accidents.

The noise is a random walk (its variance grows with the way, so that the rate of the readings
changes nothing), drawn per increment in the robot's frame, as the estimator's motion model has
it. An increment is handled as a twist `[rho_x, rho_y, phi]`, because two wheels that turn evenly
drive an arc.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.se2 import compose, exp, log

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.simulation.journey import Journey
    from hiermap_cli.simulation.spec import OdometrySpec

    Array = NDArray[np.float64]

_CHUNK = 65536  # increments at once
_DECIMALS = 9  # of noisy readings: the same bytes on every processor
_NO_TIME = 1e-9  # seconds; a shorter accident is a jump between two readings


def read_wheels(
    journey: Journey,
    seconds: Array,
    spec: OdometrySpec,
    rng: np.random.Generator | None,
) -> Array:
    """Odometry poses (M, 3) at `seconds` (M,), in a frame that begins at the first of them.

    Without `rng` there is neither noise nor slip; constant faults, bends and stretches of faults
    stay, as they belong to the world.
    """
    poses = np.zeros((len(seconds), 3))
    for first in range(0, len(seconds) - 1, _CHUNK):
        moments = seconds[first : first + _CHUNK + 1]
        increments = _false_calibration(journey.increments(moments), spec)
        if rng is not None:
            increments = _with_noise(increments, spec, rng)
        increments = _with_bends(increments, moments, journey, spec)
        increments = _with_faults(increments, moments, spec)
        poses[first : first + len(moments)] = _integrated(poses[first], increments)
    return poses if rng is None else np.round(poses, _DECIMALS)


def _integrated(start: Array, increments: Array) -> Array:
    """Poses (n + 1, 3) from the first one and n increments: headings first, then positions."""
    heading = start[2] + np.concatenate(([0.0], np.cumsum(increments[:, 2])))
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    dx, dy = increments[:, 0], increments[:, 1]
    x = start[0] + np.concatenate(([0.0], np.cumsum(c * dx - s * dy)))
    y = start[1] + np.concatenate(([0.0], np.cumsum(s * dx + c * dy)))
    # Wrapped by the group's own convention, (-pi, pi].
    return compose(np.column_stack((x, y, heading)), np.zeros(3))


def _false_calibration(increments: Array, spec: OdometrySpec) -> Array:
    """What wheels with constant faults read of true increments (n, 3)."""
    if spec.scale == spec.rotation_scale == spec.curvature == 0.0:
        return increments
    twist = log(increments)
    twist[:, :2] /= 1.0 + spec.scale
    twist[:, 2] = (twist[:, 2] - spec.curvature * twist[:, 0]) / (1.0 + spec.rotation_scale)
    return exp(twist)


def _with_noise(increments: Array, spec: OdometrySpec, rng: np.random.Generator) -> Array:
    """Increments (n, 3) with the noise of the wheels, and slips at random places."""
    twist = log(increments)
    way, angle = np.hypot(twist[:, 0], twist[:, 1]), np.abs(twist[:, 2])
    sigma_xy = np.sqrt(spec.sigma_xy_per_sqrt_m**2 * way + spec.sigma_xy_per_sqrt_rad**2 * angle)
    sigma_theta = np.sqrt(
        spec.sigma_theta_per_sqrt_m**2 * way + spec.sigma_theta_per_sqrt_rad**2 * angle
    )
    sigmas = np.column_stack((sigma_xy, sigma_xy, sigma_theta))
    noise = sigmas * rng.standard_normal(twist.shape)
    slip = spec.slip
    if slip.per_metre > 0.0:
        slips = np.sqrt(rng.poisson(slip.per_metre * way))[:, None]
        size = np.array([slip.sigma_translation, slip.sigma_translation, slip.sigma_rotation])
        noise += slips * size * rng.standard_normal(twist.shape)
    return exp(twist + noise)


def _with_bends(increments: Array, seconds: Array, journey: Journey, spec: OdometrySpec) -> Array:
    """Increments (n, 3) between `seconds` (n + 1,) with the accidents that fall among them.

    A bend is a false motion that follows the true one of an increment, in the robot's frame; one
    that lasts is spread over its time as shares of the bend's twist. Later motion is read right.
    """
    for bend in spec.bends:
        middle = 0.5 * (journey.arrivals[bend.after, 1] + journey.arrivals[bend.after + 1, 0])
        begin = middle - 0.5 * bend.duration
        done = np.clip((seconds - begin) / max(bend.duration, _NO_TIME), 0.0, 1.0)
        share = np.diff(done)
        if share.any():
            increments = compose(increments, exp(share[:, None] * log(np.array(bend.bend))))
    return increments


def _with_faults(increments: Array, seconds: Array, spec: OdometrySpec) -> Array:
    """Increments (n, 3) between `seconds` (n + 1,), spoilt where they end in a faulty stretch."""
    for fault in spec.faults:
        inside = (seconds[1:] > fault.begin) & (seconds[1:] <= fault.end)
        if inside.any():
            twist = log(increments)
            if fault.kind == "reversed":
                twist[inside, :2] *= -1.0
            else:
                twist[inside] = 0.0
            increments = exp(twist)
    return increments
