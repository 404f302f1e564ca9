"""The refined trajectory: every scan of the log, the key scans' own poses and those between."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.model import Trajectory
from hiermap_cli.mapping.refinement.odometry import motions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.mapper import Mapper
    from hiermap_cli.mapping.refinement.smoothing import Solution

    Array = NDArray[np.float64]


def pose_covariances(solution: Solution) -> Array:
    """Covariances (K, 3, 3) of the key poses' errors in the robot's frame."""
    K = len(solution.state.poses)
    out = np.zeros((K, 3, 3))
    plan = solution.structure.plan
    for own, index, S in zip(plan.own, plan.columns, solution.factor.marginals(), strict=True):
        first = own[(own < 3 * K) & (own % 3 == 0)]
        at = np.searchsorted(index, first)[:, None] + np.arange(3)
        out[first // 3] = S[at[:, :, None], at[:, None, :]]
    return out


def whole_trajectory(mapper: Mapper, solution: Solution) -> tuple[Trajectory, Array, Array]:
    """The robot in g at every scan; also its last pose, and how uncertain that is more than at
    the last key scan: the covariance (3, 3) of the invariant error that odometry adds.

    A scan between two key scans is carried by odometry from the first, and takes its share of
    what remains at the second; the noise in between is that of a bridge held at both ends. Scans
    after the last key scan stay where odometry puts them.
    """  # noqa: D205
    state, config = solution.state, mapper.config.odometry
    key_at = np.array(mapper.trail.key_at)
    stamps = np.array(mapper.trail.stamps_ns, dtype=np.int64)
    K, n = len(key_at), len(stamps)
    base = np.searchsorted(key_at, np.arange(n), side="right") - 1
    after = np.minimum(base + 1, K - 1)
    told = np.asarray(mapper.trail.increments)
    carried = motions(told, state.parameters, config)
    steps = motions(mapper.keyscans.taken().increments, state.parameters, config)

    X = se2.compose(state.poses[base], carried.pose)
    reached = se2.compose(state.poses[base], steps.pose[after])
    rest = se2.log(se2.compose(state.poses[after], se2.invert(reached)))
    f = _progress(told) / np.maximum(_progress(steps.pose[after]), 1e-9)
    f = np.clip(f, 0.0, 1.0)
    f[base == after] = 0.0
    poses = se2.compose(se2.exp(f[:, None] * rest), X)

    Ad = se2.adjoint(state.poses)
    C_keys = Ad @ pose_covariances(solution) @ Ad.transpose(0, 2, 1)
    factor = mapper.noise.odometry
    Ad_step = Ad[after]
    bridge = factor * Ad_step @ steps.covariance[after] @ Ad_step.transpose(0, 2, 1)
    g = f[:, None, None]
    C = (1.0 - g) * C_keys[base] + g * C_keys[after] + g * (1.0 - g) * bridge
    tail = base == after
    Ad_tail = se2.adjoint(poses[tail])
    extra = factor * Ad_tail @ carried.covariance[tail] @ Ad_tail.transpose(0, 2, 1)
    C[tail] += extra
    J = se2.additive_D_invariant(poses)
    C = J @ C @ J.transpose(0, 2, 1)
    trajectory = Trajectory(stamps, poses, 0.5 * (C + C.transpose(0, 2, 1)))
    return trajectory, poses[-1], extra[-1]


def _progress(increment: Array) -> Array:
    """How far an increment (..., 3) has come, with a radian counted as 30 cm."""
    return np.asarray(
        np.hypot(increment[..., 0], increment[..., 1]) + 0.3 * np.abs(increment[..., 2])
    )
