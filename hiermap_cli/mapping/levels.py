"""The areas and the environment as one: area frames in g, and the robot's trail through them.

What the filters leave are areas in frames that lie where the robot was when it entered, and
portals that join them. Here each area gets the frame of the door that it was entered by
(section 5.3), which is a change of frame by a constant and costs no information, the
environment level composes the frames in g, and the trail in the areas becomes the trajectory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR
from hiermap_cli.mapping.environment import (
    Anchors,
    Environment,
    Link,
    LoopResidual,
    compose_environment,
    loop_residuals,
)
from hiermap_cli.mapping.model import Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.estimation.stochastic_map import StochasticMap
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.mapper import Mapper
    from hiermap_cli.mapping.portals import Portal
    from hiermap_cli.mapping.trail import Trail

    Array = NDArray[np.float64]


class Levels(NamedTuple):
    """The two upper levels of the paper, K areas.

    maps: V and C(V) of each area, seen from its door's frame. frames: (K, 3) these frames in g.
    covariance: (3 + 3 K, 3 + 3 K) joint invariant covariance of V = (robot in g, frames).
    robot: (3,) in g. shifts: (K, 3) each area's door frame in the frame it was filtered in.
    trajectory: the robot in g at every scan. loops: what each loop said before any was used.
    """

    maps: tuple[StochasticMap, ...]
    frames: Array
    covariance: Array
    robot: Array
    shifts: Array
    trajectory: Trajectory
    loops: tuple[LoopResidual, ...] = ()

    def frame_covariance(self, i: int) -> Array:
        """Invariant covariance (3, 3) of frame i in g."""
        at = 3 + 3 * i
        return self.covariance[at : at + 3, at : at + 3]


def compose_levels(mapper: Mapper) -> Levels:
    """Composes a mapper's areas. The mapper's trail must be finished."""
    areas = mapper.areas
    start = np.array(mapper.config.start_pose)
    anchors, index = _anchors(areas)
    links = [Link(p.a, index[p.a][p.anchor_a], p.b, index[p.b][p.anchor_b]) for p in mapper.portals]
    environment = compose_environment(anchors, links, start, np.zeros((3, 3)))
    shifts = door_frames(len(areas), mapper.portals)
    maps = tuple(
        change_frame(_corrected(area, anchors[i], environment, i), shifts[i])
        for i, area in enumerate(areas)
    )
    robot, covariance = _robot(environment, mapper.current)
    return Levels(
        maps=maps,
        frames=se2.compose(environment.frames, shifts),
        covariance=covariance,
        robot=robot,
        shifts=shifts,
        trajectory=_trajectory(environment, mapper.trail),
        loops=tuple(loop_residuals(anchors, links, start, np.zeros((3, 3)))),
    )


def change_frame(V: StochasticMap, R_a_b: Array) -> StochasticMap:
    """V of frame a seen from frame b, which lies still in a and is exactly known there."""
    R_b_a = se2.invert(R_a_b)
    poses = se2.compose(R_b_a, V.poses)
    D = np.broadcast_to(se2.adjoint(R_b_a), (len(poses), 3, 3))
    if V.coordinates == "additive":
        D = se2.additive_D_invariant(poses) @ D @ se2.invariant_D_additive(V.poses)
    P = V.covariance.copy()
    for i, block in enumerate(D):
        where = V.columns(i)
        P[where] = block @ P[where]
        P[:, where] = P[:, where] @ block.T
    return V._replace(poses=poses, covariance=symmetrise(P))


def _anchors(areas: Sequence[AreaMap]) -> tuple[list[Anchors], list[dict[int, int]]]:
    """What the environment needs of each area, and where each anchor's uid went."""
    anchors: list[Anchors] = []
    index: list[dict[int, int]] = []
    for area in areas:
        V, f = area.V, area.features
        which = np.concatenate(([0], 1 + np.flatnonzero(f.kind == ANCHOR)))
        columns = np.concatenate([np.arange(3) + V.columns(int(i)).start for i in which])
        P = V.covariance[np.ix_(columns, columns)]
        if V.coordinates == "additive":
            J = np.zeros_like(P)
            for k, block in enumerate(se2.invariant_D_additive(V.poses[which])):
                J[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = block
            P = J @ P @ J.T
        anchors.append(Anchors(V.poses[which], P))
        index.append({int(f.uid[i - 1]): k + 1 for k, i in enumerate(which[1:])})
    return anchors, index


def door_frames(areas: int, portals: Sequence[Portal]) -> Array:
    """Where each area's door lies in the frame that it was filtered in, (K, 3).

    A new area begins at its anchor, which is its frame's origin and exactly known there.
    """
    shifts = np.zeros((areas, 3))
    entered = {0}
    for portal in portals:
        if portal.b not in entered:
            entered.add(portal.b)
            shifts[portal.b] = portal.R_anchor_d
    return shifts


def _corrected(area: AreaMap, before: Anchors, environment: Environment, i: int) -> StochasticMap:
    """The area after the loops of the environment level: what moved its anchors moves the rest.

    Conditioned on robot and anchors the rest of the area knows nothing of other areas, so that
    `e_rest += G e_anchors` and `C += G (C'_anchors - C_anchors) G^T` with the regression G.
    """
    after = environment.anchors[i]
    V = area.V
    moved = se2.log(se2.compose(after, se2.invert(before.poses))).ravel()
    first = environment.offset(i, 0)
    where = slice(first, first + len(moved))
    gain = environment.covariance[where, where] - before.covariance
    scale = np.abs(before.covariance).max(initial=0.0)
    if not moved.any() and np.abs(gain).max(initial=0.0) <= 1e-9 * scale:
        return V
    which = np.concatenate(([0], 1 + np.flatnonzero(area.features.kind == ANCHOR)))
    columns = np.concatenate([np.arange(3) + V.columns(int(k)).start for k in which])
    T = np.eye(len(V.covariance))
    if V.coordinates == "additive":
        for k, block in enumerate(se2.invariant_D_additive(V.poses)):
            T[V.columns(k), V.columns(k)] = block
    P = T @ V.covariance @ T.T
    G = P[:, columns] @ np.linalg.pinv(before.covariance, rcond=1e-12, hermitian=True)
    e = G @ moved
    P = P + G @ gain @ G.T
    steps = np.concatenate((e[:3], e[V.first_object :])).reshape(-1, 3)
    poses = se2.compose(se2.exp(steps), V.poses)
    if V.coordinates == "additive":
        for k, block in enumerate(se2.additive_D_invariant(poses)):
            T[V.columns(k), V.columns(k)] = block
        P = T @ P @ T.T
    parameters = V.parameters + e[3 : V.first_object]
    return V._replace(poses=poses, parameters=parameters, covariance=symmetrise(P))


def _robot(environment: Environment, current: int) -> tuple[Array, Array]:
    """The robot in g, (3,), and the joint covariance of it and the frames: equation 1."""
    F, P = environment.frames[current], environment.covariance
    Ad, K3 = se2.adjoint(F), 3 * len(environment.frames)
    # Its error in g is that of its area's frame and Ad(F) that of the robot in the area.
    frame, robot = slice(3 * current, 3 * current + 3), environment.offset(current, 0)
    rows = P[frame] + Ad @ P[robot : robot + 3]
    C = np.empty((3 + K3, 3 + K3))
    C[3:, 3:] = P[:K3, :K3]
    C[:3, 3:] = rows[:, :K3]
    C[3:, :3] = rows[:, :K3].T
    C[:3, :3] = rows[:, frame] + rows[:, robot : robot + 3] @ Ad.T
    return se2.compose(F, environment.anchors[current][0]), symmetrise(C)


def _trajectory(environment: Environment, trail: Trail) -> Trajectory:
    """The frame of the area in g, and the robot in the area, for every scan.

    An area's frame hangs on what happened before the robot came into the area, so that the two
    errors are independent; where a loop joins them the neglected correlation is a gain, and
    leaving it out errs to the safe side.
    """
    area = np.array(trail.area, dtype=np.int64)
    poses, C = np.array(trail.poses), np.array(trail.covariances)
    for i, F in enumerate(environment.frames):
        # Area by area: what is needed in between is small beside the trajectory.
        here = np.flatnonzero(area == i)
        poses[here] = se2.compose(F, poses[here])
        J = se2.additive_D_invariant(poses[here])
        Ad = se2.adjoint(F)
        C_here = J @ (environment.frame_covariance(i) + Ad @ C[here] @ Ad.T)
        C_here = C_here @ J.transpose(0, 2, 1)
        C[here] = 0.5 * (C_here + C_here.transpose(0, 2, 1))
    return Trajectory(np.array(trail.stamps_ns, dtype=np.int64), poses, C)
