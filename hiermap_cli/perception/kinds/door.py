"""Doors: two jambs with an opening between them.

Seen from inside an area, the wall comes to the first jamb with an end p2, and goes on from the
second jamb with an end p1. Frame: origin midway between the jambs, Y in the direction of crossing
out of the area, X along the jamb line, so against the walls' own direction; the width is the
distance of the jambs along X. From the other side both axes flip, and the jamb line seen there
is the wall's other face, a wall's thickness away.

The heading comes from the jamb *lines*, by their lengths; a jamb that no line along the wall
leads to (a thick wall's inner face, a wall that runs away) gives its point only, and where there
is no line at all the heading is that from jamb to jamb. Both points are ends of lines, uncertain
by the beam spacing. Where this side of the wall was not mapped the jambs may be those of its other
face: across the wall the door is then known to a wall's thickness only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import points, se2
from hiermap_cli.geometry.se2 import wrap
from hiermap_cli.perception.kinds.lineset import point_on_D_line
from hiermap_cli.perception.kinds.rules import (
    POSE,
    Extraction,
    Group,
    PointShape,
    RuleSet,
    SegmentShape,
    distinct,
    segment_shape,
)
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.perception.kinds.lineset import LineSet

    Array = NDArray[np.float64]

# Metres, a deviation: jambs of the wall's other face lie its thickness beyond the door's own, which
# is not seen; inside a building that is 8 to 25 cm.
THICKNESS = 0.15
FAR_TILT = 0.25 * np.pi  # radians from the jamb line to a wall that is seen from the other side
FROM_BOTH, FROM_FIRST, FROM_SECOND, FROM_POINTS = range(4)  # choices: what gives the heading


class Doors:
    """Doors and openings as wide as doors."""

    kinds: tuple[str, ...] = ("door",)
    rank: int = 20
    choices: tuple[int, ...] = ()  # the material gives both axes

    def find(self, lines: LineSet, taken: NDArray[np.bool_], config: LandmarkConfig) -> list[Group]:  # noqa: ARG002 - doors share their walls
        """Gaps between walls in one line, and the jambs of passages that the robot went through."""
        gaps = _gaps(lines, config)
        through = _passages(lines, config)
        used = {jamb for group in through for jamb in zip(group.lines, group.sides, strict=True)}
        return through + [
            group for group in gaps if used.isdisjoint(zip(group.lines, group.sides, strict=True))
        ]

    def extract(self, lines: LineSet, group: Group) -> Extraction:
        """Pose, the two jambs as points, and the jamb lines as segments."""
        jambs = _jambs(lines, group)
        width = _weight(lines, group)
        # d (alpha1, P1, alpha2, P2) / d the lines' parameters.
        by_lines = np.zeros((6, 8))
        for k in range(2):
            by_lines[3 * k, 4 * k] = 1.0
            by_lines[3 * k + 1 : 3 * k + 3, [4 * k, 4 * k + 1, 4 * k + 2 + group.sides[k]]] = (
                jambs.D_line[k]
            )
        if group.choice in (FROM_FIRST, FROM_SECOND):
            # The other jamb may be seen on the wall's other face: this face is the door's line.
            k = 0 if group.choice == FROM_FIRST else 1
            by_lines = jamb_on_line_D_jambs(jambs.lines, jambs.points, k) @ by_lines
            jambs = jambs._replace(points=jamb_on_line(jambs.lines, jambs.points, k))
        pose = door_pose(jambs.lines, jambs.points, group.choice, width)
        D = door_pose_D_jambs(jambs.lines, jambs.points, group.choice, width)
        pose_D_lines = D @ by_lines
        R_l_k = se2.invert(pose)
        shapes: list[SegmentShape | PointShape] = []
        rows = []
        for k in range(2):
            shapes.append(PointShape(points.h(R_l_k, jambs.points[k])))
            row = points.h_D_pose(R_l_k, jambs.points[k]) @ se2.invert_D_pose(pose) @ pose_D_lines
            rows.append(
                row + points.h_D_point(R_l_k, jambs.points[k]) @ by_lines[3 * k + 1 : 3 * k + 3]
            )
        for k in _along(group.choice):
            shape, row = segment_shape(pose, pose_D_lines, lines, group.lines[k], k)
            shapes.append(shape)
            rows.append(row)
        return Extraction(
            POSE,
            pose,
            pose_D_lines,
            tuple(shapes),
            np.concatenate(rows),
            _far_side(lines, group, pose, jambs),
        )


class Jambs(NamedTuple):
    """The two jambs of a door.

    lines: (2, 2) their lines. points: (2, 2) their ends. D_line: (2, 2, 3) d point / d (alpha,
    d, s).
    """

    lines: Array
    points: Array
    D_line: Array


def _jambs(lines: LineSet, group: Group) -> Jambs:
    which, sides = list(group.lines), list(group.sides)
    hesse = lines.hesse[which]
    return Jambs(hesse, lines.ends[which, sides], point_on_D_line(hesse, lines.along[which, sides]))


def _along(choice: int) -> tuple[int, ...]:
    """Which jambs have a line along the wall."""
    return {FROM_BOTH: (0, 1), FROM_FIRST: (0,), FROM_SECOND: (1,), FROM_POINTS: ()}[choice]


def _far_side(lines: LineSet, group: Group, pose: Array, jambs: Jambs) -> Array:
    """Deviations (3,) of the pose where jambs are those of the wall's other face.

    Where one jamb's wall was seen on this side, both are on its line, and nothing is left open.
    """
    if group.choice != FROM_POINTS:
        return np.zeros(3)
    far = int((np.cos(lines.theta[list(group.lines)] - pose[2]) > np.cos(FAR_TILT)).sum())
    gap = float(np.hypot(*(jambs.points[0] - jambs.points[1])))
    # One of the two takes the middle half as far, and turns the line between them.
    return np.array([0.0, 0.5 * far * THICKNESS, THICKNESS / gap if far == 1 else 0.0])


def _weight(lines: LineSet, group: Group) -> float:
    """The second line's share in the heading: a line's heading is known by its length cubed."""
    first, second = (float(lines.length[i]) ** 3 for i in group.lines)
    return second / (first + second)


def jamb_on_line(hesse: Array, jambs: Array, k: int) -> Array:
    """The jambs (2, 2) with the other one at its foot on jamb k's line."""
    t = np.array([-np.sin(hesse[k, 0]), np.cos(hesse[k, 0])])
    out = jambs.copy()
    out[1 - k] = jambs[k] + t * (t @ (jambs[1 - k] - jambs[k]))
    return out


def jamb_on_line_D_jambs(hesse: Array, jambs: Array, k: int) -> Array:
    """d (alpha1, jamb_on_line, alpha2, ...) / d (alpha1, x1, y1, alpha2, x2, y2), (6, 6)."""
    alpha = hesse[k, 0]
    t = np.array([-np.sin(alpha), np.cos(alpha)])
    t_by_alpha = -np.array([np.cos(alpha), np.sin(alpha)])
    apart = jambs[1 - k] - jambs[k]
    J = np.eye(6)
    own, other = slice(3 * k + 1, 3 * k + 3), slice(4 - 3 * k, 6 - 3 * k)
    J[other, other] = np.outer(t, t)
    J[other, own] = np.eye(2) - np.outer(t, t)
    J[other, 3 * k] = t_by_alpha * (t @ apart) + t * (t_by_alpha @ apart)
    return J


def door_pose(hesse: Array, jambs: Array, choice: int, weight: float) -> Array:
    """R_k_l (3,) of two jamb lines (2, 2) and the jambs (2, 2)."""
    if choice == FROM_POINTS:
        dx, dy = jambs[0] - jambs[1]
        theta = float(np.arctan2(dy, dx))
    else:
        share = {FROM_BOTH: weight, FROM_FIRST: 0.0, FROM_SECOND: 1.0}[choice]
        alpha = hesse[0, 0] + share * float(wrap(hesse[1, 0] - hesse[0, 0]))
        theta = alpha - 0.5 * np.pi
    return np.append(0.5 * (jambs[0] + jambs[1]), wrap(np.asarray(theta)))


def door_pose_D_jambs(hesse: Array, jambs: Array, choice: int, weight: float) -> Array:  # noqa: ARG001 - as door_pose
    """d door_pose / d (alpha1, x1, y1, alpha2, x2, y2), (3, 6)."""
    J = np.zeros((3, 6))
    J[0, 1] = J[1, 2] = J[0, 4] = J[1, 5] = 0.5
    if choice == FROM_POINTS:
        dx, dy = jambs[0] - jambs[1]
        square = dx * dx + dy * dy
        J[2, 1], J[2, 2] = -dy / square, dx / square
        J[2, 4], J[2, 5] = dy / square, -dx / square
    else:
        share = {FROM_BOTH: weight, FROM_FIRST: 0.0, FROM_SECOND: 1.0}[choice]
        J[2, 0], J[2, 3] = 1.0 - share, share
    return J


def _gaps(lines: LineSet, config: LandmarkConfig) -> list[Group]:
    """Two walls in one line, true ends facing each other, nothing in or before the gap."""
    parallel = np.abs(wrap(lines.theta[None, :] - lines.theta[:, None])) < config.parallel
    ends = (lines.kind[:, 1] != END_OPEN)[:, None] & (lines.kind[:, 0] != END_OPEN)[None, :]
    i, j = np.nonzero(parallel & ends)
    if not len(i):
        return []
    jump = lines.ends[j, 0] - lines.ends[i, 1]
    theta = lines.theta[i] + 0.5 * wrap(lines.theta[j] - lines.theta[i])
    gap = np.cos(theta) * jump[:, 0] + np.sin(theta) * jump[:, 1]
    step = np.abs(np.cos(theta) * jump[:, 1] - np.sin(theta) * jump[:, 0])
    ok = (gap > config.door_min_width) & (gap < config.door_max_width) & (step < config.door_step)
    candidates = [
        (float(s), (("end", a), ("begin", b)))
        for a, b, s in zip(i[ok].tolist(), j[ok].tolist(), step[ok], strict=True)
    ]
    found = []
    for k in distinct(candidates):
        (_, a), (_, b) = candidates[k][1]
        group = Group("door", (a, b), FROM_BOTH, (1, 0))
        if not _closed(lines, group, config):
            found.append(group)
    return found


def _closed(lines: LineSet, group: Group, config: LandmarkConfig) -> bool:
    """Whether something stands in the gap or before it, or it is the mouth of a shallow recess.

    A cabinet before a wall makes a gap too; there the wall's pieces end in concave corners.
    """
    jambs = _jambs(lines, group)
    pose = door_pose(jambs.lines, jambs.points, group.choice, 0.5)
    half = 0.5 * float(np.hypot(*(jambs.points[0] - jambs.points[1])))
    ends = points.h(se2.invert(pose), lines.ends)
    others = np.ones(len(lines), dtype=bool)
    others[list(group.lines)] = False
    u, v = np.sort(ends[..., 0], axis=1), ends[..., 1]
    overlap = np.minimum(u[:, 1], half) - np.maximum(u[:, 0], -half)
    near = (v.max(axis=1) < config.recess) & (v.min(axis=1) > -config.recess)
    across = others & near & (overlap > half)
    if across.any():
        return True
    # Something that stands out of the wall: a line from a jamb into the area.
    gap = 0.5 * config.corner_gap
    at_jamb = (np.abs(np.abs(ends[..., 0]) - half) < gap) & (np.abs(v) < gap)
    into = at_jamb.any(axis=1) & (v.min(axis=1) < -gap)
    steep = np.abs(np.sin(lines.theta - pose[2])) > np.sin(config.min_angle)
    return bool((others & into & steep).any())


def _passages(lines: LineSet, config: LandmarkConfig) -> list[Group]:
    """Jambs near where the robot passed: the nearest true end on either side."""
    found = []
    for x, y, theta, width in lines.passages:
        ends = points.h(se2.invert(np.array([x, y, theta])), lines.ends)
        jambs: list[tuple[int, int]] = []
        # Walls that run along the jamb line reach the first jamb (u > 0) with their p2.
        tilt = wrap(lines.theta - theta - np.pi)
        along = np.abs(tilt) < config.jamb_tilt
        for side, u in ((1, 0.5 * width), (0, -0.5 * width)):
            away = np.hypot(ends[..., 0] - u, ends[..., 1])
            # Of a thick wall's inner face the end on this area's side is the jamb.
            both = ~along & (away < config.jamb_radius).all(axis=1)
            away[both, np.argmax(ends[both, :, 1], axis=1)] = np.inf
            away[lines.kind == END_OPEN] = np.inf
            away[along, 1 - side] = np.inf
            away[~along] += 0.5 * config.jamb_radius  # an end of a wall in line goes before
            if not away.size or away.min() >= config.jamb_radius:
                break
            i, k = np.unravel_index(int(np.argmin(away)), away.shape)
            jambs.append((int(i), int(k)))
        if len(jambs) < 2 or jambs[0] == jambs[1] or jambs[0][0] == jambs[1][0]:
            continue
        (a, side_a), (b, side_b) = jambs
        gap = float(np.hypot(*(ends[a, side_a] - ends[b, side_b])))
        if not config.door_min_width < gap < config.passage_max_width:
            continue
        choice = {
            (True, True): FROM_BOTH,
            (True, False): FROM_FIRST,
            (False, True): FROM_SECOND,
            (False, False): FROM_POINTS,
        }[bool(along[a]), bool(along[b])]
        found.append(Group("door", (a, b), choice, (side_a, side_b)))
    return found


RULES: RuleSet = Doors()
