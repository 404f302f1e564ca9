"""Everything that a reference map and a reference trajectory tell of a run, as one list."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiermap_cli.evaluation.areas import area_metrics, topology_metrics
from hiermap_cli.evaluation.consistency import first_pose_alignment, landmark_nees, robot_nees
from hiermap_cli.evaluation.corners import corner_metrics
from hiermap_cli.evaluation.doors import door_metrics
from hiermap_cli.evaluation.placed import place
from hiermap_cli.evaluation.trajectory import ate, rpe
from hiermap_cli.evaluation.visibility import ALL_AROUND, View, viewpoints
from hiermap_cli.evaluation.walls import wall_metrics

if TYPE_CHECKING:
    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.documents.tum import TimedPoses
    from hiermap_cli.mapping.model import HierarchicalModel, Metric, Trajectory


def trajectory_metrics(trajectory: Trajectory, truth: TimedPoses) -> tuple[Metric, ...]:
    """`ate_*`, `rpe_*` and `nees_robot` of a run against a reference trajectory."""
    estimate = (trajectory.stamps_ns, trajectory.poses)
    return (
        *ate(*estimate, *truth).metrics(),
        *rpe(*estimate, *truth).metrics(),
        *robot_nees(trajectory, *truth).metrics("nees_robot"),
    )


def map_metrics(
    model: HierarchicalModel,
    trajectory: Trajectory,
    reference: ReferenceMap,
    truth: TimedPoses,
    view: View = ALL_AROUND,
) -> tuple[Metric, ...]:
    """All metrics of a model against a reference map, put together by the trajectories.

    `truth` is the robot's trajectory in the reference map's frame; with fewer than two stamps in
    common there is no alignment and nothing is measured. What the reference does not list is
    left out.
    """
    estimate = (trajectory.stamps_ns, trajectory.poses)
    best = ate(*estimate, *truth)
    R_t_g = first_pose_alignment(*estimate, *truth)
    if best.n == 0 or R_t_g is None:
        return ()
    placed = place(model, best.alignment)
    nees = landmark_nees(model, reference, R_t_g, best.alignment)
    parts = (
        corner_metrics(placed, reference, viewpoints(truth.poses), view),
        wall_metrics(placed, reference),
        door_metrics(placed, reference),
        area_metrics(placed, reference, truth.poses, view),
        topology_metrics(placed, reference),
    )
    figures = [metric for part in parts if part is not None for metric in part.metrics()]
    return (*nees.metrics("nees_landmarks"), *figures)
