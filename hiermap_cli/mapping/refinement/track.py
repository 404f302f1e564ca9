"""The refined trajectory: every scan of the log, the key scans' own poses and those between.

A scan between two key scans is carried by odometry from the first, takes its share of what
remains at the second, and is then laid on the walls by what it saw itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.keyscans import ScanSegments
from hiermap_cli.mapping.model import Trajectory
from hiermap_cli.mapping.refinement.between import laid_on_walls
from hiermap_cli.mapping.refinement.odometry import motions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.mapper import Mapper
    from hiermap_cli.mapping.refinement.smoothing import Solution

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


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


class Bridged(NamedTuple):
    """Every scan between the key scans at both sides of it, N scans.

    base, after: (N,) these key scans, the same one after the last. share: (N,) how far on the way
    between them. poses: (N, 3) carried by odometry, with their share of what remains at the key
    scan after. covariance: (N, 3, 3) what that adds to the key scans', in the robot's frame.
    """

    base: Index
    after: Index
    share: Array
    poses: Array
    covariance: Array


def whole_trajectory(mapper: Mapper, solution: Solution) -> tuple[Trajectory, Array, Array]:
    """The robot in g at every scan, its last pose, and how uncertain that is.

    The last, (3, 3), is the covariance of the invariant error that comes on top of the last key
    scan's.
    """
    stamps = np.array(mapper.trail.stamps_ns, dtype=np.int64)
    key_at = np.array(mapper.trail.key_at)
    between = _bridged(mapper, solution)
    poses, B = between.poses, between.covariance
    seen = mapper.between.taken()
    rows, kept = _rows_of(seen.stamps_ns, stamps, key_at)
    if len(rows):
        segments = _of_scans(seen.segments, kept)
        poses[rows], B[rows] = laid_on_walls(
            solution.state, poses[rows], B[rows], segments, mapper.noise, mapper.config
        )
    Ad = se2.adjoint(solution.state.poses)
    C_keys = Ad @ pose_covariances(solution) @ Ad.transpose(0, 2, 1)
    g = between.share[:, None, None]
    Ad = se2.adjoint(poses)
    own = Ad @ B @ Ad.transpose(0, 2, 1)
    C = (1.0 - g) * C_keys[between.base] + g * C_keys[between.after] + own
    J = se2.additive_D_invariant(poses)
    C = J @ C @ J.transpose(0, 2, 1)
    trajectory = Trajectory(stamps, poses, 0.5 * (C + C.transpose(0, 2, 1)))
    return trajectory, poses[-1], own[-1]


def _bridged(mapper: Mapper, solution: Solution) -> Bridged:
    state, config = solution.state, mapper.config.odometry
    key_at = np.array(mapper.trail.key_at)
    K, n = len(key_at), len(mapper.trail.stamps_ns)
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
    tail = base == after
    f[tail] = 0.0
    # The noise in between is that of a bridge held at both ends.
    B = (f * (1.0 - f))[:, None, None] * steps.covariance[after]
    B[tail] = carried.covariance[tail]
    return Bridged(
        base, after, f, se2.compose(se2.exp(f[:, None] * rest), X), mapper.noise.odometry * B
    )


def _rows_of(looked: Index, stamps: Index, key_at: Index) -> tuple[Index, Index]:
    """Rows of the trajectory that are no key scans and were looked at, and which look each is."""
    is_key = np.zeros(len(stamps), dtype=bool)
    is_key[key_at] = True
    others = np.flatnonzero(~is_key)
    if not len(looked):
        return others[:0], others[:0]
    order = np.argsort(looked, kind="stable")
    at = np.searchsorted(looked[order], stamps[others])
    which = order[np.minimum(at, len(looked) - 1)]
    same = looked[which] == stamps[others]
    return others[same], which[same]


def _of_scans(segments: ScanSegments, scans: Index) -> ScanSegments:
    """The segments of some scans, in that order, numbered anew."""
    number = np.full(int(segments.scan.max(initial=-1)) + 1 + int(scans.max(initial=0)) + 1, -1)
    number[scans] = np.arange(len(scans))
    kept = np.flatnonzero(number[segments.scan] >= 0)
    kept = kept[np.argsort(number[segments.scan[kept]], kind="stable")]
    chosen = ScanSegments._make(column[kept] for column in segments)
    return chosen._replace(scan=number[chosen.scan])


def _progress(increment: Array) -> Array:
    """How far an increment (..., 3) has come, with a radian counted as 30 cm."""
    return np.asarray(
        np.hypot(increment[..., 0], increment[..., 1]) + 0.3 * np.abs(increment[..., 2])
    )
