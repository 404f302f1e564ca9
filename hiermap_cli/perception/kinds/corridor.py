"""Corridors: two parallel walls that face each other.

Frame: X along the middle line, in the direction of the first wall (free side on its left; the
longer wall at first sight), heading midway between the two; the origin is midway between the
walls, opposite the middle of what both show. It binds y and theta; the position along the
corridor measures nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.se2 import wrap
from hiermap_cli.perception.kinds.lineset import (
    along_of,
    foot,
    foot_D_line,
    offset_of,
    point_on,
)
from hiermap_cli.perception.kinds.rules import POSE, Extraction, Group, RuleSet, segment_shape

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.perception.kinds.lineset import LineSet

    Array = NDArray[np.float64]

_STEP = 0.1  # metres
FIRST, SECOND = 0, 1  # choices: the wall whose direction X takes


class Corridors:
    """Pairs of parallel walls."""

    kinds: tuple[str, ...] = ("corridor",)
    rank: int = 30
    choices: tuple[int, ...] = (FIRST, SECOND)

    def find(self, lines: LineSet, taken: NDArray[np.bool_], config: LandmarkConfig) -> list[Group]:  # noqa: ARG002 - corridors share their walls
        """Facing walls not farther apart than `corridor_max_width`, with enough of both.

        Doors cut a corridor's walls into pieces: how far it goes is told by all pieces in line
        with the two. Of several pairs on one middle line the longest is taken.
        """
        candidates = _pairs(lines, config)
        groups: list[Group] = []
        poses: list[Array] = []
        together = _in_line(lines, config)
        for a, b in candidates:
            if _facing(lines, a, b, together) < _needed(lines, a, b, config):
                continue
            first, second = (a, b) if lines.length[a] >= lines.length[b] else (b, a)
            pose = corridor_pose(lines.hesse[[first, second]], _middle(lines, first, second), FIRST)
            if not any(_same(pose, other, config) for other in poses):
                groups.append(Group(self.kinds[0], (first, second), FIRST))
                poses.append(pose)
        return groups

    def extract(self, lines: LineSet, group: Group) -> Extraction:
        """The middle line, and both walls in its frame."""
        a, b = group.lines
        lo, hi = _stretch(lines, a, b)
        middle = _middle(lines, a, b)
        both = lines.hesse[[a, b]]
        pose = corridor_pose(both, middle, group.choice)
        D = np.zeros((3, 8))
        D[:, [0, 1, 4, 5]] = corridor_pose_D_lines(both, middle)
        first, D_first = segment_shape(pose, D, lines, a, 0)
        second, D_second = segment_shape(pose, D, lines, b, 1)
        free = np.array([max(0.5 * (hi - lo), 0.5), 0.0, 0.0])
        shape_D = np.concatenate((D_first, D_second))
        return Extraction(POSE[1:], pose, D, (first, second), shape_D, free)


def corridor_pose(hesse: Array, near: Array, choice: int) -> Array:
    """R_k_l (3,) of two facing lines (2, 2), its origin beside the fixed point `near` (2,)."""
    heading = hesse[0, 0] + 0.5 * float(wrap(hesse[1, 0] + np.pi - hesse[0, 0])) + 0.5 * np.pi
    origin = 0.5 * (foot(hesse[0], near) + foot(hesse[1], near))
    return np.append(origin, wrap(np.asarray(heading + (np.pi if choice == SECOND else 0.0))))


def corridor_pose_D_lines(hesse: Array, near: Array) -> Array:
    """d corridor_pose / d (alpha1, d1, alpha2, d2), (3, 4)."""
    J = np.zeros((3, 4))
    for k in range(2):
        J[:2, 2 * k : 2 * k + 2] = 0.5 * foot_D_line(hesse[k], near)
        J[2, 2 * k] = 0.5
    return J


def _pairs(lines: LineSet, config: LandmarkConfig) -> list[tuple[int, int]]:
    """Parallel walls that face each other at a corridor's width, the longest first."""
    against = np.abs(wrap(lines.theta[None, :] - lines.theta[:, None] - np.pi))
    middles = lines.ends.mean(axis=1)
    width = -offset_of(lines.hesse[:, None], middles[None])
    near = (against < config.parallel) & (width > config.corridor_min_width)
    i, j = np.nonzero(np.triu(near & (width < config.corridor_max_width), 1))
    size = lines.length[i] * lines.length[j]
    return [(int(i[k]), int(j[k])) for k in np.lexsort((j, i, -size))]


def _needed(lines: LineSet, a: int, b: int, config: LandmarkConfig) -> float:
    """Metres that must be seen of both walls."""
    width = -float(offset_of(lines.hesse[a], lines.ends[b].mean(axis=0)))
    return max(config.corridor_min_length, config.corridor_ratio * width)


def _middle(lines: LineSet, a: int, b: int) -> Array:
    """The point midway between the walls, opposite the middle of what was seen of them."""
    lo, hi = _stretch(lines, a, b)
    on_first = point_on(lines.hesse[a], np.asarray(0.5 * (lo + hi)))
    middle: Array = 0.5 * (on_first + foot(lines.hesse[b], on_first))
    return middle


def _stretch(lines: LineSet, a: int, b: int) -> tuple[float, float]:
    """Where, along line a, the two walls were seen, from first to last."""
    ends = np.concatenate((along_of(lines.hesse[a], lines.ends[b]), lines.along[a]))
    return float(ends.min()), float(ends.max())


def _in_line(lines: LineSet, config: LandmarkConfig) -> NDArray[np.bool_]:
    """Which lines (second axis) are pieces in line with which ones (first axis), (n, n)."""
    turned = np.abs(wrap(lines.theta - lines.theta[:, None]))
    off = np.abs(offset_of(lines.hesse[:, None, None], lines.ends)).max(axis=2)
    return np.asarray((turned < config.parallel) & (off < config.same))


def _facing(lines: LineSet, a: int, b: int, in_line: NDArray[np.bool_]) -> float:
    """Metres along line a on which pieces in line with a face pieces in line with b."""
    s = along_of(lines.hesse[a], lines.ends)
    steps = np.arange(float(s.min()), float(s.max()), _STEP) + 0.5 * _STEP
    both = np.ones(len(steps), dtype=bool)
    for line in (a, b):
        pieces = np.sort(s[in_line[line]], axis=1)
        both &= ((pieces[:, :1] <= steps) & (steps <= pieces[:, 1:])).any(axis=0)
    return float(both.sum()) * _STEP


def _same(pose: Array, other: Array, config: LandmarkConfig) -> bool:
    """Whether two middle lines are one."""
    dx, dy = pose[:2] - other[:2]
    across = abs(-np.sin(other[2]) * dx + np.cos(other[2]) * dy)
    turned = abs(np.sin(pose[2] - other[2]))
    return bool(across < config.same and turned < config.parallel)


RULES: RuleSet = Corridors()
