"""A single long wall, where no other landmark has it.

Frame: X along the wall from p1 to p2, the free side on the left. It binds y and theta, and x
where one of its ends was seen: the origin is then that end, p1 before p2; else it is the middle
of what was seen, which is a convention that measures nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.se2 import wrap
from hiermap_cli.perception.kinds.lineset import foot_D_line, point_on, point_on_D_line
from hiermap_cli.perception.kinds.rules import POSE, Extraction, Group, RuleSet, exact_segment
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.perception.kinds.lineset import LineSet

    Array = NDArray[np.float64]

FIRST, SECOND, MIDDLE = 0, 1, 2  # choices: where the origin lies


class Walls:
    """Walls by themselves."""

    kinds: tuple[str, ...] = ("wall",)
    rank: int = 90
    choices: tuple[int, ...] = ()

    def find(self, lines: LineSet, taken: NDArray[np.bool_], config: LandmarkConfig) -> list[Group]:
        """Lines of at least `min_wall` that no other landmark has."""
        groups = []
        for i in np.flatnonzero(~taken & (lines.length >= config.min_wall)).tolist():
            known = np.flatnonzero(lines.kind[i] != END_OPEN)
            choice = int(known[0]) if len(known) else MIDDLE
            groups.append(Group(self.kinds[0], (i,), choice))
        return groups

    def extract(self, lines: LineSet, group: Group) -> Extraction:
        """The wall's own frame."""
        (i,) = group.lines
        S = lines.hesse[i]
        bound = group.choice != MIDDLE
        s = lines.along[i, group.choice] if bound else lines.along[i].mean()
        pose = np.append(point_on(S, s), wrap(S[0] + 0.5 * np.pi))
        D = np.zeros((3, 4))
        D[2, 0] = 1.0
        if bound:
            D[:2, [0, 1, 2 + group.choice]] = point_on_D_line(S, s)
        else:
            D[:2, :2] = foot_D_line(S, pose[:2])
        free = np.array([0.0 if bound else max(0.5 * float(lines.length[i]), 0.5), 0.0, 0.0])
        shape = exact_segment(pose, lines, i)
        binds = POSE if bound else POSE[1:]
        return Extraction(binds, pose, D, (shape,), np.zeros((2, 4)), free)


RULES: RuleSet = Walls()
