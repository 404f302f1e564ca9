"""Corridor crossings: the mouth of a side corridor in a corridor's wall.

Walking along the wall with the free side on the left: the wall (line 1) ends in a convex corner,
the side corridor's near wall (2) runs away from it, its far wall (3) comes back, and from a second
convex corner the wall (4) goes on in line. Wider than a door, and of four lines; a crossing of
two corridors shows two mouths.

Frame: origin midway between the two vertices, Y into the side corridor, X from the second vertex
to the first: as of a door.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.lines import intersect, intersect_D_lines
from hiermap_cli.geometry.se2 import wrap
from hiermap_cli.perception.kinds.corner import RULES as CORNERS
from hiermap_cli.perception.kinds.lineset import offset_of
from hiermap_cli.perception.kinds.rules import (
    POSE,
    Extraction,
    Group,
    RuleSet,
    distinct,
    segment_shape,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.perception.kinds.lineset import LineSet

    Array = NDArray[np.float64]


class Crossings:
    """Mouths of side corridors."""

    kinds: tuple[str, ...] = ("crossing",)
    rank: int = 40
    choices: tuple[int, ...] = ()

    def find(self, lines: LineSet, taken: NDArray[np.bool_], config: LandmarkConfig) -> list[Group]:
        """Two convex corners that face each other across an opening wider than a door."""
        convex = [g for g in CORNERS.find(lines, taken, config) if g.kind == "corner_convex"]
        candidates = []
        for first in convex:
            for second in convex:
                group = (*first.lines, *second.lines)
                if first != second and len(set(group)) == 4 and _is_mouth(lines, group, config):
                    V1 = intersect(lines.hesse[group[0]], lines.hesse[group[1]])
                    V2 = intersect(lines.hesse[group[2]], lines.hesse[group[3]])
                    width = float(np.hypot(*(V1 - V2)))
                    candidates.append((width, (("first", group[:2]), ("second", group[2:]), group)))
        kept = distinct([(width, uses[:2]) for width, uses in candidates])
        return [Group(self.kinds[0], candidates[k][1][2]) for k in kept]

    def extract(self, lines: LineSet, group: Group) -> Extraction:
        """The mouth's frame, and the four walls in it."""
        hesse = lines.hesse[list(group.lines)]
        pose = crossing_pose(hesse)
        D = np.zeros((3, 16))
        own = (4 * np.arange(4)[:, None] + np.arange(2)).ravel()
        D[:, own] = crossing_pose_D_lines(hesse)
        shapes, rows = [], []
        for slot, line in enumerate(group.lines):
            shape, row = segment_shape(pose, D, lines, line, slot)
            shapes.append(shape)
            rows.append(row)
        return Extraction(POSE, pose, D, tuple(shapes), np.concatenate(rows), np.zeros(3))


def _is_mouth(lines: LineSet, group: tuple[int, ...], config: LandmarkConfig) -> bool:
    """Whether four lines (wall, near side, far side, wall) are the mouth of a corridor."""
    wall, near, far, on = group
    theta = lines.theta
    if abs(float(wrap(theta[on] - theta[wall]))) > config.parallel:
        return False
    if abs(float(wrap(theta[far] - theta[near] - np.pi))) > config.parallel:
        return False
    V1 = intersect(lines.hesse[wall], lines.hesse[near])
    V2 = intersect(lines.hesse[far], lines.hesse[on])
    step = V2 - V1
    width = float(np.cos(theta[wall]) * step[0] + np.sin(theta[wall]) * step[1])
    if not config.door_max_width < width < config.corridor_max_width:
        return False
    deep = min(float(lines.length[near]), float(lines.length[far])) >= config.crossing_depth
    in_line = abs(float(offset_of(lines.hesse[wall], V2))) < config.same
    return deep and in_line


def crossing_pose(hesse: Array) -> Array:
    """R_k_l (3,) of the four lines (4, 2)."""
    V1, V2 = intersect(hesse[0], hesse[1]), intersect(hesse[2], hesse[3])
    dx, dy = V1 - V2
    return np.append(0.5 * (V1 + V2), np.arctan2(dy, dx))


def crossing_pose_D_lines(hesse: Array) -> Array:
    """d crossing_pose / d (alpha, d) of the four lines, (3, 8)."""
    V = np.array([intersect(hesse[0], hesse[1]), intersect(hesse[2], hesse[3])])
    dx, dy = V[0] - V[1]
    square = dx * dx + dy * dy
    by_points = np.zeros((3, 4))
    by_points[:2, :2] = by_points[:2, 2:] = 0.5 * np.eye(2)
    by_points[2] = np.array([-dy, dx, dy, -dx]) / square
    by_lines = np.zeros((4, 8))
    by_lines[:2, :4] = intersect_D_lines(hesse[0], hesse[1])
    by_lines[2:, 4:] = intersect_D_lines(hesse[2], hesse[3])
    return by_points @ by_lines


RULES: RuleSet = Crossings()
