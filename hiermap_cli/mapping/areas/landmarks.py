"""From an area's walls and ends to its landmarks, each with its own model (section 4).

The area's filter corrects walls and ends; landmarks are groups of them. Their poses in the area
and their shapes in their own frames are functions of the state, so that their errors follow from
C(V) by the Jacobians, and two landmarks that share a wall are correlated through it, exactly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.model import Estimate, LandmarkModel, PointFeature, SegmentFeature
from hiermap_cli.perception.kinds import rule_sets
from hiermap_cli.perception.kinds.rules import (
    PointShape,
    SegmentShape,
    find_groups,
    free_covariance,
)
from hiermap_cli.perception.utility import sightings, worth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.estimation.stochastic_map import StochasticMap
    from hiermap_cli.mapping.areas.walls import WallLines
    from hiermap_cli.perception.kinds.rules import RuleSet

    Array = NDArray[np.float64]


class Draft(NamedTuple):
    """A landmark before it is written down.

    pose: (3,) R_a_l. pose_by_state: (3, N), additive by the error of V. pose_noise: (3, 3) what
    the state does not hold of the pose's error, in the area's axes; shape_noise: (2 f, 2 f).
    lines: the lines behind it.
    """

    kind: str
    binds: tuple[str, ...]
    pose: Array
    pose_by_state: Array
    pose_noise: Array
    shape: tuple[SegmentShape | PointShape, ...]
    shape_by_state: Array
    shape_noise: Array
    observations: int
    utility: float
    lines: tuple[int, ...]


class Choice(NamedTuple):
    """The landmarks kept, and how many were not: `dropped` groups, `forgotten` lines."""

    kept: tuple[Draft, ...]
    dropped: int
    forgotten: int


def find_landmarks(
    walls: WallLines, config: LandmarkConfig, rules: Sequence[RuleSet] | None = None
) -> Choice:
    """The landmarks of an area that are worth keeping.

    rules: other rule sets than the table's.
    """
    lines = walls.lines
    drafts = []
    for rule, group in find_groups(lines, rule_sets() if rules is None else rules, config):
        found = rule.extract(lines, group)
        by_state = walls.by_state[lines.columns(group.lines)]
        seen = sightings(lines, group)
        drafts.append(
            Draft(
                kind=group.kind,
                binds=found.binds,
                pose=found.pose,
                pose_by_state=found.pose_D_lines @ by_state,
                pose_noise=free_covariance(found),
                shape=found.shape,
                shape_by_state=found.shape_D_lines @ by_state,
                shape_noise=np.zeros((2 * len(found.shape), 2 * len(found.shape))),
                observations=seen,
                utility=seen * worth(lines, group, found, config),
                lines=group.lines,
            )
        )
    kept = [d for d in drafts if d.utility >= config.min_utility]
    kept = [d for d in kept if d.observations >= config.least_seen]
    used = {line for draft in kept for line in draft.lines}
    return Choice(tuple(kept), len(drafts) - len(kept), len(lines) - len(used))


def joint_covariance(V: StochasticMap, drafts: Sequence[Draft]) -> Array:
    """C(V) of (robot, landmark poses) in the area, additive, (3 + 3 k, 3 + 3 k)."""
    M = np.zeros((3 + 3 * len(drafts), len(V.covariance)))
    M[:3, :3] = V.additive_D_error(V.robot)
    for i, draft in enumerate(drafts):
        M[3 + 3 * i : 6 + 3 * i] = draft.pose_by_state
    C = M @ V.covariance @ M.T
    for i, draft in enumerate(drafts):
        C[3 + 3 * i : 6 + 3 * i, 3 + 3 * i : 6 + 3 * i] += draft.pose_noise
    return symmetrise(C)


def landmark_model(V: StochasticMap, draft: Draft, id_: str, area: str) -> LandmarkModel:
    """A landmark's own model: V = (robot in its frame, features), with C(V)."""
    R_l_a = se2.invert(draft.pose)
    D_pose = se2.compose_D_first(R_l_a, V.robot) @ se2.invert_D_pose(draft.pose)
    D_robot = se2.compose_D_second(R_l_a, V.robot)
    k = len(draft.shape)
    M = np.zeros((3 + 2 * k, len(V.covariance)))
    M[:3] = D_pose @ draft.pose_by_state
    M[:3, :3] += D_robot @ V.additive_D_error(V.robot)
    M[3:] = draft.shape_by_state
    # A landmark hangs on few of the area's walls and ends.
    by = np.flatnonzero(M.any(axis=0))
    C = M[:, by] @ V.covariance[by[:, None], by] @ M[:, by].T
    C[:3, :3] += D_pose @ draft.pose_noise @ D_pose.T
    C[3:, 3:] += draft.shape_noise
    C = symmetrise(C)
    features: list[SegmentFeature | PointFeature] = []
    for i, shape in enumerate(draft.shape):
        block = C[3 + 2 * i : 5 + 2 * i, 3 + 2 * i : 5 + 2 * i]
        if isinstance(shape, SegmentShape):
            p, q = (float(value) for value in shape.pq)
            features.append(SegmentFeature(p, q, shape.line_type, block, shape.ends, shape.endless))
        else:
            features.append(PointFeature(shape.mean, block))
    return LandmarkModel(
        id=id_,
        area=area,
        kind=draft.kind,
        binds=draft.binds,
        robot=Estimate(id_, se2.compose(R_l_a, V.robot), C[:3, :3]),
        features=tuple(features),
        covariance=C,
        observations=draft.observations,
        utility=draft.utility,
    )
