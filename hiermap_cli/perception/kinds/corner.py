"""Corners: two walls that meet (figures 3, 4 and 5).

Walking along the walls with the free side on the left, one comes *in* to the vertex along the
first line and goes *out* along the second. A turn to the left is a concave corner (of a room), a
turn to the right a convex one (of a pillar). Which line comes in is the same from wherever the
corner is seen.

Frame: origin at the vertex; X runs from the vertex along the longer line, which knows its heading
best; of two that are equally long it is the outgoing one of a concave corner and the incoming one
of a convex one. So the X line is p = q = 0, exactly, and of the other only p, by the angle
between the two, is open: 4 parameters become 3 of the pose and 1 of the shape.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import points
from hiermap_cli.geometry.lines import chart, hesse_to_pq, intersect, intersect_D_lines
from hiermap_cli.geometry.se2 import invert, wrap
from hiermap_cli.perception.kinds.lineset import along_of
from hiermap_cli.perception.kinds.rules import (
    POSE,
    Extraction,
    Group,
    RuleSet,
    SegmentShape,
    distinct,
    endless,
    exact_segment,
)
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.perception.kinds.lineset import LineSet

    Array = NDArray[np.float64]

OUT, IN = 0, 1  # choices: the line that carries X
_EQUAL = 1.05  # of the lengths; nearer to each other they are taken as equal


class Corners:
    """Concave and convex corners."""

    kinds: tuple[str, ...] = ("corner_concave", "corner_convex")
    rank: int = 10
    choices: tuple[int, ...] = (OUT, IN)

    def find(self, lines: LineSet, taken: NDArray[np.bool_], config: LandmarkConfig) -> list[Group]:  # noqa: ARG002 - corners share their walls
        """Lines whose ends meet: `lines` are (in, out).

        The ways from both ends to where the lines cross are nothing but errors: as a chi-square
        of the two, by what is known of the ends, and by how well walls are lines. A wall that
        was not seen to its end may stop short of the corner by more, but was not seen beyond it.
        An edge before a wall fails by both: it stops short, and beyond it the wall goes on.
        Where neither wall truly ends there, half of that chi-square is allowed. An end must be
        known to be near the vertex: one that fits because it may be anywhere tells nothing.

        Who sees the vertex of a concave corner sees both walls end there. Where one of them only
        went out of sight, it may go on behind an edge that stands before it. The walls of a
        convex corner hide each other, and of them one end may be open.
        """
        turn = wrap(lines.theta[None, :] - lines.theta[:, None])
        wide = (np.abs(turn) > config.min_angle) & (np.abs(turn) < np.pi - config.min_angle)
        i, j = np.nonzero(wide)
        if not len(i):
            return []
        V = intersect(lines.hesse[i], lines.hesse[j])
        short = np.column_stack(
            (
                along_of(lines.hesse[i], V) - lines.along[i, 1],
                lines.along[j, 0] - along_of(lines.hesse[j], V),
            )
        )
        true = np.column_stack((lines.kind[i, 1], lines.kind[j, 0])) != END_OPEN
        ok = (np.abs(short) < config.corner_gap).all(axis=1)
        i, j, short, true = i[ok], j[ok], short[ok], true[ok]
        if not len(i):
            return []
        rough = np.where(true | (short < 0.0), config.corner_touch, config.open_reach)
        sigmas = np.where(true, _gap_sigmas(lines, i, j), 0.0)
        cost = (short**2 / (rough**2 + sigmas**2)).sum(axis=1)
        near = cost < np.where(true.any(axis=1), 1.0, 0.5) * config.corner_chi2
        near &= (short + 2.0 * sigmas < config.corner_known).all(axis=1)
        near &= true.all(axis=1) | (turn[i, j] < 0.0)
        i, j, cost = i[near], j[near], cost[near]
        candidates = [
            (float(c), (("in", a), ("out", b)))
            for a, b, c in zip(i.tolist(), j.tolist(), cost, strict=True)
        ]
        groups = []
        for k in distinct(candidates):
            a, b = int(i[k]), int(j[k])
            concave = turn[a, b] > 0.0
            kind = self.kinds[0] if concave else self.kinds[1]
            groups.append(Group(kind, (a, b), _first_choice(lines, a, b, concave=bool(concave))))
        return groups

    def extract(self, lines: LineSet, group: Group) -> Extraction:
        """Vertex, heading of the X line, and p of the other."""
        a, b = group.lines
        first, second = lines.hesse[a], lines.hesse[b]
        pose = corner_pose(first, second, group.choice)
        pose_D_lines = np.zeros((3, 8))
        pose_D_lines[:, [0, 1, 4, 5]] = corner_pose_D_lines(first, second, group.choice)
        on, other = (b, a) if group.choice == OUT else (a, b)
        pq, line_type = corner_shape(first, second, group.choice)
        D = corner_shape_D_lines(first, second, group.choice)
        ends = points.h(invert(pose), lines.ends[other])
        shapes = {
            on: exact_segment(pose, lines, on),
            other: SegmentShape(pq, line_type, ends, endless(lines, other)),
        }
        shape_D_lines = np.zeros((4, 8))
        row = 0 if other == a else 2
        shape_D_lines[row : row + 2, [0, 1, 4, 5]] = D
        return Extraction(
            POSE, pose, pose_D_lines, (shapes[a], shapes[b]), shape_D_lines, np.zeros(3)
        )


def _gap_sigmas(lines: LineSet, i: NDArray[np.int64], j: NDArray[np.int64]) -> Array:
    """Sigmas (k, 2) of the way from the end of line i, of line j, to where the lines cross."""
    first, second = lines.hesse[i], lines.hesse[j]
    V_D_lines = intersect_D_lines(first, second)
    where = np.concatenate((4 * i[:, None] + np.arange(4), 4 * j[:, None] + np.arange(4)), axis=1)
    C = lines.covariance[where[:, :, None], where[:, None, :]]
    sigmas = np.empty((len(i), 2))
    for k, (own, at, end) in enumerate(((first, 0, 3), (second, 4, 6))):
        # Along the line ds = t . dP, and t turns with the line: - d dalpha.
        t = np.column_stack((-np.sin(own[:, 0]), np.cos(own[:, 0])))
        row = np.zeros((len(i), 8))
        row[:, [0, 1, 4, 5]] = np.einsum("ki,kij->kj", t, V_D_lines)
        row[:, at] -= own[:, 1]
        row[:, end] -= 1.0
        sigmas[:, k] = np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", row, C, row), 0.0))
    return sigmas


def _first_choice(lines: LineSet, a: int, b: int, *, concave: bool) -> int:
    incoming, outgoing = float(lines.length[a]), float(lines.length[b])
    if outgoing > _EQUAL * incoming:
        return OUT
    if incoming > _EQUAL * outgoing:
        return IN
    return OUT if concave else IN


def corner_pose(first: Array, second: Array, choice: int) -> Array:
    """R_k_l (3,) of the lines that come in and go out, in Hesse form.

    X runs from the vertex: along the outgoing line, or against the incoming one.
    """
    heading = second[0] + 0.5 * np.pi if choice == OUT else first[0] - 0.5 * np.pi
    return np.append(intersect(first, second), wrap(heading))


def corner_pose_D_lines(first: Array, second: Array, choice: int) -> Array:
    """d corner_pose / d (alpha1, d1, alpha2, d2), (3, 4)."""
    J = np.zeros((3, 4))
    J[:2] = intersect_D_lines(first, second)
    J[2, 2 if choice == OUT else 0] = 1.0
    return J


def corner_shape(first: Array, second: Array, choice: int) -> tuple[Array, int]:
    """(p, q) of the line that does not carry X, in the corner's frame, and its chart; q = 0."""
    hesse = np.array([_angle(first, second, choice), 0.0])
    line_type = chart(hesse)
    pq = hesse_to_pq(hesse, line_type)
    pq[1] = 0.0
    return pq, int(line_type)


def corner_shape_D_lines(first: Array, second: Array, choice: int) -> Array:
    """d (p, q) of corner_shape / d (alpha1, d1, alpha2, d2), (2, 4); q is exact."""
    pq, line_type = corner_shape(first, second, choice)
    # p = -tan(alpha) in chart 0 and -cot(alpha) in chart 1.
    slope = (-1.0 if line_type == 0 else 1.0) * (1.0 + pq[0] ** 2)
    sign = 1.0 if choice == OUT else -1.0
    return np.array([[sign * slope, 0.0, -sign * slope, 0.0], [0.0, 0.0, 0.0, 0.0]])


def _angle(first: Array, second: Array, choice: int) -> float:
    """Angle of the other line's normal in the corner's frame."""
    other, on = (first, second) if choice == OUT else (second, first)
    heading = on[0] + (0.5 if choice == OUT else -0.5) * np.pi
    return float(wrap(other[0] - heading))


RULES: RuleSet = Corners()
