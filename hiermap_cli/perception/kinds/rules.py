"""What a rule set is: which lines make a landmark, where its frame lies, what its shape is.

A landmark found in a frame k has the pose R_k_l and, in its own frame, segments and points. All
are functions of its lines' parameters, so that the errors of the lines carry over to the pose
and the shape, jointly, by the two Jacobians of an `Extraction` (section 4: "error propagation").
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from hiermap_cli.geometry import lines as geometry
from hiermap_cli.geometry import points as point_geometry
from hiermap_cli.geometry import se2
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.perception.kinds.lineset import LineSet

    Array = NDArray[np.float64]

POSE = ("x", "y", "theta")


class Group(NamedTuple):
    """Lines that make a landmark.

    kind: its name in the document. lines: indices into the LineSet, in an order that the kind
    gives. choice: which of the kind's possible frames is taken; a later view of the landmark
    takes the choice already made, or its frame would flip. sides: the ends of the lines that
    matter, where the kind says so.
    """

    kind: str
    lines: tuple[int, ...]
    choice: int = 0
    sides: tuple[int, ...] = ()


class SegmentShape(NamedTuple):
    """A line (p, q) of a chart in the landmark's frame, p1 and p2 (2, 2), which end is open."""

    pq: Array
    line_type: int
    ends: Array
    endless: tuple[bool, bool]


class PointShape(NamedTuple):
    """A point (2,) in the landmark's frame."""

    mean: Array


class Extraction(NamedTuple):
    """A landmark taken out of lines.

    binds: which of x, y, theta it binds. pose: (3,) R_k_l. pose_D_lines: (3, 4 c) by the
    parameters of its c lines. shape: f features, and shape_D_lines: (2 f, 4 c), with zero rows
    for what the frame's rule makes exact. free: (3,) deviations, along the landmark's own axes,
    of what it does not bind, and of what its lines do not tell beside their own errors.
    """

    binds: tuple[str, ...]
    pose: Array
    pose_D_lines: Array
    shape: tuple[SegmentShape | PointShape, ...]
    shape_D_lines: Array
    free: Array


class RuleSet(Protocol):
    """One kind of landmark, or several that share their rules.

    kinds: the names in the document. rank: rule sets of a lower rank choose their lines first.
    choices: of frames for one group that differ in their heading; empty where there is only one.
    """

    kinds: tuple[str, ...]
    rank: int
    choices: tuple[int, ...]

    def find(self, lines: LineSet, taken: NDArray[np.bool_], config: LandmarkConfig) -> list[Group]:
        """The groups that qualify, with the frame chosen as at first sight.

        `taken` (n,) tells which lines belong to landmarks already found.
        """
        ...

    def extract(self, lines: LineSet, group: Group) -> Extraction:
        """Pose and shape of a group, in the frame of its choice."""
        ...


def find_groups(
    lines: LineSet, rules: Sequence[RuleSet], config: LandmarkConfig
) -> list[tuple[RuleSet, Group]]:
    """All landmarks that the rules see in the lines."""
    taken = np.zeros(len(lines), dtype=bool)
    found: list[tuple[RuleSet, Group]] = []
    for rule in rules:
        groups = rule.find(lines, taken, config) if len(lines) else []
        found.extend((rule, group) for group in groups)
        for group in groups:
            taken[list(group.lines)] = True
    return found


def re_express(rule: RuleSet, lines: LineSet, group: Group, heading: float) -> Group:
    """The group in that choice of frame whose heading is nearest to the one already known."""

    def turned(choice: int) -> float:
        pose = rule.extract(lines, group._replace(choice=choice)).pose
        return float(abs(se2.wrap(pose[2] - heading)))

    return group._replace(choice=min(rule.choices, key=turned)) if rule.choices else group


def pose_covariance(lines: LineSet, group: Group, found: Extraction) -> Array:
    """C_k_l (3, 3), additive: what the lines leave open, and what they do not tell."""
    columns = lines.columns(group.lines)
    J = found.pose_D_lines
    C = J @ lines.covariance[np.ix_(columns, columns)] @ J.T + free_covariance(found)
    return np.asarray(0.5 * (C + C.T))


def free_covariance(found: Extraction) -> Array:
    """Covariance (3, 3) in frame k of what the lines do not tell, from `free`."""
    turn = np.eye(3)
    turn[:2, :2] = se2.rotation(found.pose[2])
    return np.asarray(turn @ np.diag(found.free**2) @ turn.T)


def shape_covariance(lines: LineSet, group: Group, found: Extraction) -> Array:
    """Joint covariance (2 f, 2 f) of the features."""
    columns = lines.columns(group.lines)
    J = found.shape_D_lines
    C = J @ lines.covariance[np.ix_(columns, columns)] @ J.T
    return np.asarray(0.5 * (C + C.T))


def segment_shape(
    pose: Array, pose_D_lines: Array, lines: LineSet, line: int, slot: int
) -> tuple[SegmentShape, Array]:
    """A line of the set in the landmark's frame, `S_l = g(invert(R_k_l), S_k)` (section 5.1).

    slot: the line's place among those of the group. Returns its Jacobian (2, 4 c) too.
    """
    R_l_k = se2.invert(pose)
    S = lines.hesse[line]
    moved = geometry.g_hesse(R_l_k, S)
    line_type = int(geometry.chart(moved))
    to_pq = geometry.hesse_to_pq_D_hesse(moved, np.array(line_type))
    D = geometry.g_hesse_D_pose(R_l_k, S) @ se2.invert_D_pose(pose) @ pose_D_lines
    D[:, 4 * slot : 4 * slot + 2] += geometry.g_hesse_D_line(R_l_k, S)
    shape = SegmentShape(
        geometry.hesse_to_pq(moved, np.array(line_type)),
        line_type,
        point_geometry.h(R_l_k, lines.ends[line]),
        endless(lines, line),
    )
    return shape, to_pq @ D


def exact_segment(pose: Array, lines: LineSet, line: int) -> SegmentShape:
    """A line that carries the landmark's X axis: p = q = 0, perfectly known."""
    ends = point_geometry.h(se2.invert(pose), lines.ends[line])
    ends[:, 1] = 0.0
    return SegmentShape(np.zeros(2), 1, ends, endless(lines, line))


def endless(lines: LineSet, line: int) -> tuple[bool, bool]:
    """Which ends of a line were never seen as true ones."""
    first, second = (int(kind) == END_OPEN for kind in lines.kind[line])
    return first, second


def distinct(found: Sequence[tuple[float, tuple[object, ...]]]) -> list[int]:
    """Indices of candidates (cost, what they use) that use nothing twice; the cheapest first."""
    used: set[object] = set()
    kept = []
    for i in sorted(range(len(found)), key=lambda i: (found[i][0], i)):
        if used.isdisjoint(found[i][1]):
            used.update(found[i][1])
            kept.append(i)
    return sorted(kept)
