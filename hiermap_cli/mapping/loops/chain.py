"""The path as a chain of fragments: what is known of each one's place by the one before.

Two witnesses: the odometry, and the walls that both have seen. Together they tell how much the
filter can have gone wrong on the way, and in which direction: along a blank corridor only the
odometry speaks. The filter's own covariances do not tell it; they are of areas, and the areas
are larger than what they are true over.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.loops.correspondences import Candidates, correspondences
from hiermap_cli.mapping.loops.evidence import evidence
from hiermap_cli.mapping.loops.graph import Edges, moved

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.estimation.noise import NoiseScale
    from hiermap_cli.mapping.keyscans import KeyScans
    from hiermap_cli.mapping.loops.fragments import Fragments

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]

LEAP = 4.0  # sigmas of a fault that an odometry may have
LEAST_UNEVEN = 0.04  # of the factor on the variance of the walls' unevenness


class Steps(NamedTuple):
    """The K steps that led to the key scans.

    covariance: (K, 3, 3) of the odometry, in the robot's frame after the step. broken: (K,)
    where the odometry has failed, the filter has not gone where it led, or the scan shows no wall
    that the filter knew. leapt: (K,) where the filter has gone so far from there that no fault of
    the odometry explains it: it has found itself elsewhere, and may be wrong by as much.
    """

    covariance: Array
    broken: Mask
    leapt: Mask


def steps_of(keyscans: KeyScans, poses: Array, config: Config, noise: NoiseScale) -> Steps:
    """What the odometry says of every step, and whether the filter's poses (K, 3) agree."""
    c, loops = config.odometry, config.loops
    Q = step_noise(keyscans, config, noise)
    broken = ~keyscans.trusted
    off = se2.between(keyscans.increments[1:], se2.between(poses[:-1], poses[1:]))
    r = se2.log(off)
    floor = np.square([loops.step_floor, loops.step_floor, loops.step_floor_angle])
    S = Q[1:] + np.diag(floor)
    broken[1:] |= np.einsum("ni,nij,nj->n", r, np.linalg.inv(S), r) > loops.broken_gate
    broken |= _blind(keyscans)
    broken[0] = False
    fault = np.square([c.fault_sigma_xy, c.fault_sigma_xy, c.fault_sigma_theta])
    Q[broken] += np.diag(fault)
    distance = np.concatenate(([0.0], np.hypot(off[:, 0], off[:, 1])))
    turn = np.concatenate(([0.0], np.abs(off[:, 2])))
    leapt = (distance > LEAP * c.fault_sigma_xy) | (turn > LEAP * c.fault_sigma_theta)
    leapt &= broken
    Q[leapt, [[0], [1]], [[0], [1]]] += np.square(distance[leapt])
    Q[leapt, 2, 2] += np.square(turn[leapt])
    return Steps(Q, broken, leapt)


def _blind(keyscans: KeyScans) -> Mask:
    """(K,) which key scans show no wall that the filter knew: it went where the odometry led."""
    s = keyscans.segments
    known = np.bincount(s.scan[s.wall >= 0], minlength=len(keyscans.increments))
    return np.asarray(known == 0)


def step_noise(keyscans: KeyScans, config: Config, noise: NoiseScale) -> Array:
    """Covariance (K, 3, 3) of each key scan's odometry, in the robot's frame after it.

    The noise of `estimation.motion`, row by row the same.
    """
    c = config.odometry
    dx, dy, turn = keyscans.increments.T
    distance, angle = np.hypot(dx, dy), np.abs(turn)
    var_x = c.sigma_xy_per_sqrt_m**2 * distance + c.sigma_xy_per_sqrt_rad**2 * angle
    var_t = c.sigma_theta_per_sqrt_m**2 * distance + c.sigma_theta_per_sqrt_rad**2 * angle
    Q = np.zeros((len(dx), 3, 3))
    Q[:, 0, 0], Q[:, 1, 1] = var_x, var_x + var_t * np.square(distance) / 3.0
    Q[:, 1, 2] = Q[:, 2, 1] = np.copysign(0.5 * var_t * distance, dx)
    Q[:, 2, 2] = var_t
    return np.asarray(noise.odometry * Q)


def chain(
    fragments: Fragments, poses: Array, steps: Steps, config: Config, noise: NoiseScale
) -> Edges:
    """The F - 1 steps from fragment to fragment, as the filter's poses (K, 3) have them.

    Args:
        fragments: of the path.
        poses: of the key scans, in g.
        steps: that led to them. Over a broken one the walls are a poor witness: the filter lies
            where they fit, be it the right place or not.
        config: the inflation, design section 8.3.
        noise: what is added for each fragment is for walls that are none, so that it is as large
            as the walls of this log are uneven.
    """
    c = config.loops
    frames = poses[fragments.centre]
    n = len(frames)
    i, j = np.arange(n - 1), np.arange(1, n)
    R = se2.between(frames[i], frames[j])
    total = np.cumsum(moved(steps.covariance, poses), axis=0)[fragments.centre]
    C = moved(np.diff(total, axis=0), se2.invert(frames[i]))
    if n > 1:
        asked = Candidates(i, j, R, np.zeros((n - 1, 3, 3)))
        pairs = correspondences(fragments.walls, asked, c)
        seen = evidence(fragments.walls, pairs, n - 1, i, R, c).information
        seen[_between(fragments, steps.leapt)] = 0.0
        C = np.asarray(np.linalg.inv(np.linalg.inv(C) + seen), dtype=float)
    uneven = max(noise.walls, LEAST_UNEVEN)
    sound = uneven * np.square([c.chain_floor, c.chain_floor, c.chain_floor_angle])
    broken = np.square([c.broken_floor, c.broken_floor, c.broken_floor_angle])
    floor = np.where(broken_between(fragments, steps)[:, None], broken, sound)
    # The floor is of where the next fragment lies, not of this one's origin.
    at = np.column_stack((R[:, :2], np.zeros(n - 1)))
    return Edges(i, j, R, c.chain_inflation * C + moved(floor[:, :, None] * np.eye(3), at))


def broken_between(fragments: Fragments, steps: Steps) -> Mask:
    """Whether a step is broken between the middles of a fragment and the next one, (F - 1,)."""
    return _between(fragments, steps.broken)


def _between(fragments: Fragments, steps: Mask) -> Mask:
    return np.asarray(np.diff(np.cumsum(steps)[fragments.centre]) > 0)


def carried(fragments: Fragments, poses: Array, frames: Array, Q: Array) -> Array:
    """The key poses (K, 3) when the fragments have got the frames (F, 3).

    Between the middles of two fragments a key scan goes with both of them: what they disagree
    about is spread over the way between them by the noise of its steps, so that a step whose
    odometry has failed takes most of it.
    """
    n = len(fragments.centre)
    corrected = se2.compose(frames[fragments.of_key], fragments.R_f_k)
    if n < 2:
        return corrected
    cost = Q[:, 0, 0] + Q[:, 1, 1] + Q[:, 2, 2] + 1e-12
    way = np.cumsum(cost)
    key = np.arange(len(poses))
    before = np.clip(np.searchsorted(fragments.centre, key, side="right") - 1, 0, n - 2)
    a, b = fragments.centre[before], fragments.centre[before + 1]
    share = np.clip((way - way[a]) / (way[b] - way[a]), 0.0, 1.0)
    with_first = se2.compose(frames[before], se2.between(poses[a], poses))
    with_second = se2.compose(frames[before + 1], se2.between(poses[b], poses))
    return se2.interpolate(with_first, with_second, share)
