"""The metrics of eval.json: their order, their units, and why one was not measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiermap_cli.documents.eval_file import Unmeasured

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from hiermap_cli.mapping.model import Metric

# name: (units, group, what is missing where the group was measured and this was not)
METRICS = {
    "ate_rmse": ("m", "trajectory", ""),
    "ate_mean": ("m", "trajectory", ""),
    "ate_max": ("m", "trajectory", ""),
    "rpe_trans_rmse": ("m", "trajectory", "the common trajectory is shorter than a metre"),
    "rpe_rot_rmse": ("rad", "trajectory", "the common trajectory is shorter than a metre"),
    "relations_trans_mean": ("m", "relations", ""),
    "relations_trans_std": ("m", "relations", ""),
    "relations_rot_mean": ("rad", "relations", ""),
    "relations_rot_std": ("rad", "relations", ""),
    "relations_missing": ("1", "relations", ""),
    "nees_robot": ("1", "nees", "every pose has a singular covariance"),
    "nees_landmarks": ("1", "map nees", "no corner or door of the model matches a true one"),
    "nees_areas": ("1", "map nees", "no area has three corners that match true ones"),
    "corner_precision": ("1", "corners", "the model has no corner"),
    "corner_recall": ("1", "corners", "no corner of a visited area was in sight"),
    "corner_rmse": ("m", "corners", "no corner of the model matches a true one"),
    "wall_rmse": ("m", "walls", "no wall of the model lies within 0.5 m of a true one"),
    "wall_outliers": ("1", "walls", "the model has no wall"),
    "door_precision": ("1", "doors", "the model has no crossed door"),
    "door_recall": ("1", "doors", "the reference has no visited door"),
    "door_rmse": ("m", "doors", "no door of the model matches a true one"),
    "area_precision": ("1", "areas", "no area of the model has an extent"),
    "area_recall": ("1", "areas", "no visited area of the reference was seen from inside"),
    "area_f1_iou50": ("1", "areas", "neither the model nor the reference has an area"),
    "topology_precision": ("1", "topology", "the model's areas have no crossed door between them"),
    "topology_recall": ("1", "topology", "the reference's areas have no visited door between them"),
    "occupancy_agreement": ("1", "occupancy", "the model has no wall"),
    "free_agreement": ("1", "occupancy", "no area of the model has an extent"),
}


def in_order(metrics: Iterable[Metric]) -> tuple[Metric, ...]:
    """The metrics as in the table above, then those of the run itself in their own order."""
    place = {name: i for i, name in enumerate(METRICS)}
    return tuple(sorted(metrics, key=lambda metric: place.get(metric.name, len(place))))


def unmeasured(measured: Iterable[str], reasons: Mapping[str, str]) -> tuple[Unmeasured, ...]:
    """What of the table was not measured, and why.

    Args:
        measured: names of what was.
        reasons: of groups that could not be measured at all.
    """
    known = set(measured)
    return tuple(
        Unmeasured(name, reasons.get(group) or missing)
        for name, (_, group, missing) in METRICS.items()
        if name not in known
    )
