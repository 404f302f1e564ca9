"""Names, units and meanings of the figures that a run gives about itself, without any truth.

They are public: report.json carries them by these names, and limits are set on them. What can be
counted from a finished model or from trajectories is computed here; what only the estimator
knows (`KNOWN_BY_THE_ESTIMATOR`) it puts into `MapResult.metrics` by `metric`.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.median import median
from hiermap_cli.geometry.se2 import between, compose, invert, wrap
from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.model import HierarchicalModel, Trajectory

    Array = NDArray[np.float64]

# name: (units, meaning, what n counts)
KNOWN_BY_THE_ESTIMATOR = {
    "scans_processed": ("1", "scans that the filter used", "scans of the log"),
    "scans_matched": ("1", "scans used of which something matched the map", "scans used"),
    "matches": ("1", "measurements matched with known landmarks", "measurements"),
    "matching_failures": (
        "1",
        "scans used that matched nothing where something was known",
        "scans",
    ),
    "landmarks_forgotten": ("1", "landmarks dropped by their utility", "landmarks ever begun"),
    "areas_reentered": ("1", "returns into a known area", "entries of areas"),
    "loops_closed": ("1", "loop edges accepted at the environment level", "loops proposed"),
    "loops_rejected": ("1", "loop edges refused as inconsistent", "loops proposed"),
    "relocations": ("1", "times that a lost robot was found again", "times that it was lost"),
    "nis_mean": ("1", "normalised innovation squared per degree of freedom; 1 fits", "updates"),
    "nis_inside_95": ("1", "share of updates whose NIS lies in its 95 % band", "updates"),
    "nis_<kind>": ("1", "NIS per degree of freedom of one kind's landmarks", "matches"),
    "innovation_lag1": ("1", "correlation of successive innovations of a wall; 0 fits", "pairs"),
    "loop_nis": ("1", "loop residuals squared, per degree of freedom; 1 fits", "loops"),
    "odometry_scale_translation": ("1", "estimated true distance per odometry's", "updates"),
    "odometry_scale_rotation": ("1", "estimated true rotation per odometry's", "updates"),
    "odometry_curvature": ("rad/m", "estimated heading drift per metre", "updates"),
    "laser_x": ("m", "estimated laser position ahead of where odometry turns", "updates"),
    "odometry_scale_translation_sigma": ("1", "its standard deviation", "updates"),
    "odometry_scale_rotation_sigma": ("1", "its standard deviation", "updates"),
    "odometry_curvature_sigma": ("rad/m", "its standard deviation", "updates"),
    "laser_x_sigma": ("m", "its standard deviation", "updates"),
    "noise_odometry": ("1", "variance of the odometry, of the configured one", "updates"),
    "noise_walls": ("1", "variance of the walls' unevenness, of the configured one", "updates"),
    "noise_laser": ("1", "variance of the laser's ranges, of the configured one", "updates"),
}

COUNTED_FROM_THE_MODEL = {
    "areas": ("1", "areas of the model", "areas"),
    "rooms": ("1", "areas of kind room", "areas"),
    "corridors": ("1", "areas of kind corridor", "areas"),
    "doors": ("1", "doors and openings that were crossed", "doors"),
    "door_crossings": ("1", "crossings of all doors", "doors"),
    "landmarks": ("1", "landmarks kept", "landmarks"),
    "landmarks_<kind>": ("1", "landmarks kept of one kind", "landmarks"),
}

OF_ONE_TRAJECTORY = {
    "path_length": ("m", "length of the final trajectory", "poses"),
    "robot_position_sigma_median": ("m", "median position deviation in g", "poses"),
    "robot_position_sigma_end": ("m", "position deviation in g at the end", "poses"),
    "odometry_correction_end": ("m", "how far odometry alone would be off at the end", "poses"),
    "odometry_correction_end_rot": ("rad", "the same of the heading", "poses"),
    "odometry_correction_max": ("m", "how far odometry alone would be off at worst", "poses"),
}

TAKEN_FROM_TRAJECTORIES = {
    **OF_ONE_TRAJECTORY,
    **{
        f"{prefix}_{name}": (units, f"{meaning}, by {what}", n)
        for prefix, what in (("filter", "the filter alone"), ("refined", "the refinement"))
        for name, (units, meaning, n) in OF_ONE_TRAJECTORY.items()
    },
    "refinement_max": ("m", "largest difference of the filter's and the final pose", "poses"),
}

_UNITS = {
    name: units
    for table in (KNOWN_BY_THE_ESTIMATOR, COUNTED_FROM_THE_MODEL, TAKEN_FROM_TRAJECTORIES)
    for name, (units, _, _) in table.items()
}


def metric(name: str, value: float, n: int) -> Metric:
    """A metric of one of the names above, with its units.

    Raises:
        KeyError: no such name; add it to its table first.
    """
    return Metric(name=name, units=_UNITS[name], value=float(value), n=int(n))


def model_metrics(model: HierarchicalModel) -> tuple[Metric, ...]:
    """The counts of a model."""
    kinds = Counter(landmark.kind for landmark in model.landmarks)
    areas = Counter(area.kind for area in model.areas)
    doors = model.environment.doors
    crossings = sum(door.crossings for door in doors)
    n_areas, n_landmarks = len(model.areas), len(model.landmarks)
    return (
        metric("areas", n_areas, n_areas),
        metric("rooms", areas["room"], n_areas),
        metric("corridors", areas["corridor"], n_areas),
        metric("doors", len(doors), len(doors)),
        metric("door_crossings", crossings, len(doors)),
        metric("landmarks", n_landmarks, n_landmarks),
        *(
            Metric(f"landmarks_{kind}", "1", float(count), n_landmarks)
            for kind, count in sorted(kinds.items())
        ),
    )


def trajectory_metrics(
    final: Trajectory, by_filter: Trajectory, odometry: Array
) -> tuple[Metric, ...]:
    """Figures of the trajectories of a run.

    Args:
        final: as refined, N poses.
        by_filter: by the filter alone, N poses.
        odometry: (N, 3), the robot in the odometry's frame at the same stamps; it is put
            together with `final` at the first pose.
    """
    n = len(final.poses)
    if n == 0:
        return ()
    refined = np.linalg.norm(final.poses[:, :2] - by_filter.poses[:, :2], axis=1)
    both = (("", final), ("filter_", by_filter), ("refined_", final))
    return (
        *(
            metric(prefix + name, value, n)
            for prefix, trajectory in (both if final is not by_filter else both[:2])
            for name, value in _track_figures(trajectory, odometry).items()
        ),
        metric("refinement_max", float(refined.max()), n),
    )


def _track_figures(trajectory: Trajectory, odometry: Array) -> dict[str, float]:
    steps = np.linalg.norm(np.diff(trajectory.poses[:, :2], axis=0), axis=1)
    variances = np.trace(trajectory.covariances[:, :2, :2], axis1=1, axis2=2)
    sigma = np.sqrt(np.maximum(variances, 0.0))
    R_g_o = compose(trajectory.poses[0], invert(odometry[0]))
    error = between(trajectory.poses, compose(R_g_o, odometry))
    off = np.linalg.norm(error[:, :2], axis=1)
    return {
        "path_length": float(steps.sum()),
        "robot_position_sigma_median": float(median(sigma)),
        "robot_position_sigma_end": float(sigma[-1]),
        "odometry_correction_end": float(off[-1]),
        "odometry_correction_end_rot": float(abs(wrap(error[-1, 2]))),
        "odometry_correction_max": float(off.max()),
    }
