"""Error of relative poses against true relations (Kuemmerle et al. 2009).

The metric does not depend on any global frame: it compares the robot's displacement between two
times with the displacement that hand-made scan alignments gave.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.trajectory import poses_at
from hiermap_cli.geometry.se2 import between
from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.documents.relations import Relations

    Array = NDArray[np.float64]

MAX_GAP_S = 1.0  # a relation with a stamp farther than this from a pose is missing


class RelationMetrics(NamedTuple):
    """Mean and population standard deviation, metres and radians; nan where `n` is 0.

    `n` relations were compared, `missing` had no pose near one of their stamps.
    """

    trans_mean: float
    trans_std: float
    rot_mean: float
    rot_std: float
    n: int
    missing: int

    def metrics(self) -> tuple[Metric, ...]:
        """The figures under the names of eval.json; only the missing ones where none was used."""
        missing = Metric("relations_missing", "1", float(self.missing), self.n)
        if self.n == 0:
            return (missing,)
        return (
            Metric("relations_trans_mean", "m", self.trans_mean, self.n),
            Metric("relations_trans_std", "m", self.trans_std, self.n),
            Metric("relations_rot_mean", "rad", self.rot_mean, self.n),
            Metric("relations_rot_std", "rad", self.rot_std, self.n),
            missing,
        )


class RelationErrors(NamedTuple):
    """Per relation (M,): norm of the translation (m), absolute angle (rad), whether it was used."""

    trans: Array
    rot: Array
    used: NDArray[np.bool_]


def relation_errors(
    stamps_ns: NDArray[np.int64], poses: Array, relations: Relations
) -> RelationErrors:
    """`e = (estimated relation)^-1 o (true relation)` of every relation, split in its two norms.

    stamps_ns (N,) and poses (N, 3) are the estimated trajectory in any frame.
    """
    first = poses_at(stamps_ns, poses, relations.stamps1_ns, MAX_GAP_S)
    second = poses_at(stamps_ns, poses, relations.stamps2_ns, MAX_GAP_S)
    error = between(between(first.poses, second.poses), relations.poses)
    return RelationErrors(
        np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2]), first.found & second.found
    )


def relations_metrics(
    stamps_ns: NDArray[np.int64],
    poses: Array,
    relations: Relations,
    max_span_s: float | None = None,
) -> RelationMetrics:
    """The figures `relations_*` of a trajectory: stamps_ns (N,), poses (N, 3) in any frame.

    With `max_span_s`, only relations whose stamps are less than that many seconds apart: over
    10 s they judge odometry and matching, over all of them the whole map.
    """
    if max_span_s is not None:
        span_ns = np.abs(relations.stamps2_ns - relations.stamps1_ns)
        relations = relations.select(span_ns < max_span_s * 1e9)
    errors = relation_errors(stamps_ns, poses, relations)
    trans, rot = errors.trans[errors.used], errors.rot[errors.used]
    missing = len(errors.used) - len(trans)
    if len(trans) == 0:
        return RelationMetrics(math.nan, math.nan, math.nan, math.nan, 0, missing)
    return RelationMetrics(
        float(trans.mean()),
        float(trans.std()),
        float(rot.mean()),
        float(rot.std()),
        len(trans),
        missing,
    )
