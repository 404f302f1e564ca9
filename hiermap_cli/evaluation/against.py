"""Everything that a reference map and a reference trajectory tell of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.evaluation.areas import area_metrics, topology_metrics
from hiermap_cli.evaluation.consistency import first_pose_alignment, landmark_nees, robot_nees
from hiermap_cli.evaluation.corners import corner_metrics
from hiermap_cli.evaluation.doors import door_metrics
from hiermap_cli.evaluation.occupied import occupancy_metrics
from hiermap_cli.evaluation.placed import place
from hiermap_cli.evaluation.trajectory import ate, rpe
from hiermap_cli.evaluation.visibility import ALL_AROUND, View, viewpoints
from hiermap_cli.evaluation.walls import wall_metrics

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hiermap_cli.documents.occupancy import OccupancyGrid
    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.documents.tum import TimedPoses
    from hiermap_cli.evaluation.areas import AreaMetrics, TopologyMetrics
    from hiermap_cli.evaluation.corners import CornerMetrics
    from hiermap_cli.evaluation.doors import DoorMetrics
    from hiermap_cli.evaluation.occupied import OccupancyMetrics
    from hiermap_cli.evaluation.placed import PlacedModel
    from hiermap_cli.evaluation.walls import WallMetrics
    from hiermap_cli.mapping.model import HierarchicalModel, Metric, Trajectory

    Array = NDArray[np.float64]


class MapFindings(NamedTuple):
    """A model against a reference map, part by part; None of what the reference does not list."""

    corners: CornerMetrics | None
    walls: WallMetrics | None
    doors: DoorMetrics | None
    areas: AreaMetrics | None
    topology: TopologyMetrics | None
    occupancy: OccupancyMetrics | None = None

    def metrics(self) -> tuple[Metric, ...]:
        """All figures that could be measured."""
        return tuple(metric for part in self if part is not None for metric in part.metrics())


def compare_maps(
    placed: PlacedModel,
    reference: ReferenceMap,
    poses: Array,
    view: View = ALL_AROUND,
    grid: OccupancyGrid | None = None,
) -> MapFindings:
    """A model that lies in the reference's frame against it.

    Args:
        placed: the model.
        reference: what is truly there.
        poses: (N, 3) of the robot, the truth where it is known, in the reference's frame: what it
            could see from there is asked for.
        view: of its laser.
        grid: a map of cells in the reference's frame.
    """
    return MapFindings(
        corners=corner_metrics(placed, reference, viewpoints(poses), view),
        walls=wall_metrics(placed, reference),
        doors=door_metrics(placed, reference),
        areas=area_metrics(placed, reference, poses, view),
        topology=topology_metrics(placed, reference),
        occupancy=None if grid is None else occupancy_metrics(placed, grid),
    )


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
    nees = landmark_nees(model, reference, R_t_g, best.alignment)
    findings = compare_maps(place(model, best.alignment), reference, truth.poses, view)
    return (*nees.metrics("nees_landmarks"), *findings.metrics())
