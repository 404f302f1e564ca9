"""Doors: the portals that people would call so, as landmarks of both areas and in g.

The robot's way through a door tells where it is to some ten centimetres; where the jambs' walls
and ends were mapped, the door landmark of either area (see `perception.kinds.door`) tells it
better. Seen from its two areas a door lies on the two faces of its wall; the door of the
environment lies between them, so that the wall's thickness is never taken as zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import points, se2
from hiermap_cli.mapping.areas.landmarks import Draft
from hiermap_cli.mapping.portals import anchor_index
from hiermap_cli.perception.kinds.lineset import foot, foot_D_line
from hiermap_cli.perception.kinds.rules import POSE, PointShape, SegmentShape, exact_segment

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.mapping.areas.joining import JoinedArea
    from hiermap_cli.mapping.areas.walls import WallLines
    from hiermap_cli.mapping.portals import Portal
    from hiermap_cli.perception.kinds.lineset import LineSet

    Array = NDArray[np.float64]

TURNED = np.array([0.0, 0.0, np.pi])
NEAR = 0.7  # metres from where the robot went through to the landmark of that door


class Side(NamedTuple):
    """A portal seen from one of its areas.

    portal: its index. anchor: where its anchor stands among V's poses. R_anchor_d: (3,) from
    there to the door's frame by this area's rule, Y out of the area. width: metres.
    """

    portal: int
    anchor: int
    R_anchor_d: Array
    width: float


def door_sides(area: JoinedArea, portals: Sequence[Portal]) -> list[Side]:
    """The doors of an area that the robot went through; those inside it are none."""
    sides = []
    for i, portal in enumerate(portals):
        if portal.kind != "door" or (portal.a in area.parts) == (portal.b in area.parts):
            continue
        from_a = portal.a in area.parts
        part, uid = (portal.a, portal.anchor_a) if from_a else (portal.b, portal.anchor_b)
        anchor = anchor_index(area.map, area.uid(part, uid))
        R_anchor_d = portal.R_anchor_d if from_a else se2.compose(portal.R_anchor_d, TURNED)
        sides.append(Side(i, anchor, R_anchor_d, portal.width))
    return sides


def passages(area: JoinedArea, sides: Sequence[Side]) -> Array:
    """x, y, theta, width of the doors in the area's frame, (m, 4)."""
    out = np.zeros((len(sides), 4))
    for row, side in zip(out, sides, strict=True):
        row[:3] = se2.compose(area.map.V.poses[side.anchor], side.R_anchor_d)
        row[3] = side.width
    return out


def door_drafts(
    area: JoinedArea,
    walls: WallLines,
    sides: Sequence[Side],
    drafts: Sequence[Draft],
    config: LandmarkConfig,
) -> tuple[list[Draft], dict[int, int]]:
    """The area's landmarks with one for each of its doors, and which one it is, by portal.

    A door of which no jambs were mapped gets a landmark from the robot's way through it.
    """
    out = list(drafts)
    index: dict[int, int] = {}
    for side, (x, y, theta, _) in zip(sides, passages(area, sides), strict=True):
        best, nearest = -1, NEAR
        for i, draft in enumerate(drafts):
            apart = float(np.hypot(draft.pose[0] - x, draft.pose[1] - y))
            turned = abs(float(se2.wrap(draft.pose[2] - theta)))
            fits = draft.kind == "door" and turned < 1.0 and i not in index.values()
            if fits and apart < nearest:
                best, nearest = i, apart
        if best < 0:
            best = len(out)
            out.append(_passed(area, walls, side, config))
        index[side.portal] = best
    return out, index


def _passed(area: JoinedArea, walls: WallLines, side: Side, config: LandmarkConfig) -> Draft:
    """A door landmark from the robot's way through it, and a wall beside it if there is one.

    The way tells where along the wall the opening is, and how wide; the wall, where it was
    mapped, tells the rest better.
    """
    V = area.map.V
    anchor = V.poses[side.anchor]
    passed = se2.compose(anchor, side.R_anchor_d)
    by_state = np.zeros((3, len(V.covariance)))
    by_state[:, V.columns(side.anchor)] = se2.additive_D_invariant(passed) @ V.invariant_D_error(
        anchor
    )
    sigma = np.array([config.passage_sigma, config.passage_depth, config.passage_sigma_theta])
    half = np.array([0.5 * side.width, 0.0])
    shape: tuple[SegmentShape | PointShape, ...] = (PointShape(half), PointShape(-half))
    pose, beside = passed, _beside(walls.lines, passed, side.width, config)
    if beside is not None:
        S = walls.lines.hesse[beside]
        pose = on_wall(passed, S)
        by_pose, by_line = on_wall_D_passed(S), on_wall_D_line(passed, S)
        rows = walls.by_state[4 * beside : 4 * beside + 2]
        by_state = by_pose @ by_state + by_line @ rows
        sigma = np.array([config.passage_sigma, 0.0, 0.0])
        shape = (*shape, exact_segment(pose, walls.lines, beside))
    turn = np.eye(3)
    turn[:2, :2] = se2.rotation(pose[2])
    jamb = np.diag([config.passage_sigma, 0.0]) ** 2
    shape_noise = np.zeros((2 * len(shape), 2 * len(shape)))
    shape_noise[:4, :4] = np.block([[jamb, -jamb], [-jamb, jamb]])  # the width between them
    return Draft(
        kind="door",
        binds=POSE,
        pose=pose,
        pose_by_state=by_state,
        pose_noise=turn @ np.diag(sigma**2) @ turn.T,
        shape=shape,
        shape_by_state=np.zeros((2 * len(shape), len(V.covariance))),
        shape_noise=shape_noise,
        observations=config.least_seen,
        utility=config.min_utility,
        lines=() if beside is None else (beside,),
    )


def _beside(lines: LineSet, door: Array, width: float, config: LandmarkConfig) -> int | None:
    """The longest wall that runs along the line between the jambs and reaches one of them."""
    if not len(lines):
        return None
    along = np.abs(se2.wrap(lines.theta - door[2] - np.pi)) < config.jamb_tilt
    ends = points.h(se2.invert(door), lines.ends)
    # p2 leads to the jamb at positive X, p1 from the other; either may seem to overhang it.
    u = np.column_stack((-ends[:, 0, 0], ends[:, 1, 0])) - 0.5 * width
    near = (np.abs(u) < config.jamb_radius) & (np.abs(ends[..., 1]) < config.jamb_radius)
    fits = np.flatnonzero(along & near.any(axis=1) & (lines.length > config.jamb_radius))
    return int(fits[np.argmax(lines.length[fits])]) if len(fits) else None


def on_wall(passed: Array, hesse: Array) -> Array:
    """R_a_d (3,) of a door on its wall, beside where it was passed."""
    return np.append(foot(hesse, passed[:2]), se2.wrap(hesse[0] - 0.5 * np.pi))


def on_wall_D_passed(hesse: Array) -> Array:
    """d on_wall / d passed, (3, 3): it moves along the wall only."""
    t = np.array([-np.sin(hesse[0]), np.cos(hesse[0])])
    J = np.zeros((3, 3))
    J[:2, :2] = np.outer(t, t)
    return J


def on_wall_D_line(passed: Array, hesse: Array) -> Array:
    """d on_wall / d (alpha, d) of the wall, (3, 2)."""
    return np.vstack((foot_D_line(hesse, passed[:2]), [1.0, 0.0]))


class DoorInG(NamedTuple):
    """A door in g: pose (3,), additive covariance (3, 3), width."""

    pose: Array
    covariance: Array
    width: float


def door_in_g(frame: Array, C_frame: Array, V_door: Draft, C_door: Array) -> DoorInG:
    """A door landmark of an area in g. frame: (3,) R_g_a, C_frame and C_door additive."""
    J1 = se2.compose_D_first(frame, V_door.pose)
    J2 = se2.compose_D_second(frame, V_door.pose)
    C = symmetrise(J1 @ C_frame @ J1.T + J2 @ C_door @ J2.T)
    jambs = [shape.mean for shape in V_door.shape if isinstance(shape, PointShape)]
    width = float(np.hypot(*(jambs[0] - jambs[1])))
    return DoorInG(se2.compose(frame, V_door.pose), C, width)


def between_faces(first: DoorInG, second: DoorInG | None) -> DoorInG:
    """The door midway between its two faces, Y from the first area to the second.

    The two know of each other through the crossing; as their correlation is not held here, the
    larger covariance of the two is kept, which errs to the safe side.
    """
    if second is None:
        return first
    turned = se2.compose(second.pose, TURNED)
    middle = se2.interpolate(first.pose, turned, np.asarray(0.5))
    larger = first if np.trace(first.covariance) >= np.trace(second.covariance) else second
    return DoorInG(middle, larger.covariance, 0.5 * (first.width + second.width))
