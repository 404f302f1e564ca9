"""A run against all that is known to be true: the body of `hiermap eval` on values."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hiermap_cli.documents.eval_file import EvalDocument
from hiermap_cli.documents.reference import ReferenceMap
from hiermap_cli.errors import InputError
from hiermap_cli.evaluation.against import MapFindings, compare_maps
from hiermap_cli.evaluation.alignment import Alignment, align_by_maps
from hiermap_cli.evaluation.consistency import (
    Nees,
    first_pose_alignment,
    landmark_nees,
    robot_nees,
)
from hiermap_cli.evaluation.frames import area_nees
from hiermap_cli.evaluation.limits import judge_limits
from hiermap_cli.evaluation.listing import listed_errors, worst_relations
from hiermap_cli.evaluation.names import in_order, unmeasured
from hiermap_cli.evaluation.pairing import no_overlap, relations_warning, trajectory_warning
from hiermap_cli.evaluation.placed import PlacedModel, place
from hiermap_cli.evaluation.relations import MAX_GAP_S as RELATION_GAP_S
from hiermap_cli.evaluation.relations import relation_errors, relations_metrics
from hiermap_cli.evaluation.trajectory import MAX_GAP_S, ate, rpe
from hiermap_cli.evaluation.trust import Trusted, trusted
from hiermap_cli.evaluation.visibility import ALL_AROUND, View
from hiermap_cli.geometry.se2 import compose

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hiermap_cli.documents.occupancy import OccupancyGrid
    from hiermap_cli.documents.relations import Relations
    from hiermap_cli.documents.tum import TimedPoses
    from hiermap_cli.evaluation.limits import Limit
    from hiermap_cli.mapping.model import HierarchicalModel, Metric, Trajectory

    Array = NDArray[np.float64]

# What of the run's own figures says how far it can be trusted; they stand in eval.json too.
OWN = ("matching_failures", "nis_mean", "innovation_lag1", "loop_nis")
_INSIDE = 0.5  # share of a trajectory that must lie on the reference's ground to be in its frame


class Run(NamedTuple):
    """What `hiermap run` left.

    model: None where the folder has none. trajectory: its covariances are empty, (0, 3, 3), where
    there is no file of them. own: metrics of report.json; consistency, events: its keys, empty
    without a report. view: of the laser.
    """

    trajectory: Trajectory
    model: HierarchicalModel | None = None
    own: tuple[Metric, ...] = ()
    consistency: Mapping[str, Any] = {}
    events: Sequence[Mapping[str, Any]] = ()
    view: View = ALL_AROUND


class Given(NamedTuple):
    """What is held to be true; None of what is not given. `grid` lies in the reference's frame.

    names: where each was read from, for messages.
    """

    reference: ReferenceMap | None = None
    grid: OccupancyGrid | None = None
    truth: TimedPoses | None = None
    relations: Relations | None = None
    names: Mapping[str, str] = {}


class Judgement(NamedTuple):
    """The document, and what a picture of both maps needs."""

    document: EvalDocument
    placed: PlacedModel | None = None
    findings: MapFindings | None = None


def judge(run: Run, given: Given, limits: Sequence[Limit] = ()) -> Judgement:
    """All metrics that can be measured, what could not, errors by name, verdict and limits.

    Raises:
        InputError: the true trajectory or the relations have no time in common with the run.
    """
    metrics: list[Metric] = []
    reasons: dict[str, str] = {}
    details: dict[str, Any] = {}
    _trajectory(run, given, metrics, reasons, details)
    _relations(run, given, metrics, reasons, details)
    mapped = _map(run, given, reasons, details)
    metrics += mapped.metrics
    nees = _nees(run, given, mapped, reasons)
    metrics += [m for name, one in nees.items() for m in one.metrics(name)]
    metrics = [m for m in metrics if not math.isnan(m.value)]
    trust: Trusted = trusted(run.trajectory, run.model, nees, run.consistency, run.events)
    details["consistency"] = trust.document()
    if mapped.placed is not None and run.model is not None and mapped.findings is not None:
        landmarks = [nees[name] for name in ("nees_landmarks", "nees_areas") if name in nees]
        listed = listed_errors(run.model, mapped.placed, mapped.findings, landmarks)
        details.setdefault("errors", {}).update(listed)
    own = [m for m in run.own if m.name in OWN or m.name.startswith("nis_")]
    known = {m.name for m in metrics}
    metrics += [m for m in own if m.name not in known]
    values = {m.name: m.value for m in (*run.own, *metrics)}
    document = EvalDocument(
        metrics=in_order(metrics),
        limits=judge_limits(limits, values),
        unmeasured=unmeasured((m.name for m in metrics), reasons),
        verdict=trust.sentence,
        warnings=_warnings(run, given, mapped, reasons),
        details=details,
    )
    return Judgement(document, mapped.placed, mapped.findings)


def _trajectory(
    run: Run,
    given: Given,
    metrics: list[Metric],
    reasons: dict[str, str],
    details: dict[str, Any],
) -> None:
    if given.truth is None:
        reasons["trajectory"] = "no reference trajectory was given"
        return
    estimate = (run.trajectory.stamps_ns, run.trajectory.poses)
    best = ate(*estimate, *given.truth)
    if best.n == 0:
        name = _name(given, "trajectory")
        raise InputError(no_overlap(name, estimate[0], given.truth.stamps_ns, MAX_GAP_S))
    metrics += best.metrics()
    metrics += rpe(*estimate, *given.truth).metrics()
    details["trajectory"] = {
        "alignment": best.alignment.tolist(),
        "compared": best.n,
        "of": len(given.truth.stamps_ns),
    }


def _name(given: Given, role: str) -> str:
    return given.names.get(role, f"the {role}")


def _relations(
    run: Run,
    given: Given,
    metrics: list[Metric],
    reasons: dict[str, str],
    details: dict[str, Any],
) -> None:
    relations = given.relations
    if relations is None:
        reasons["relations"] = "no relations were given"
        return
    found = relations_metrics(run.trajectory.stamps_ns, run.trajectory.poses, relations)
    if found.n == 0:
        stamps = np.concatenate((relations.stamps1_ns, relations.stamps2_ns))
        name = _name(given, "relations")
        raise InputError(no_overlap(name, run.trajectory.stamps_ns, stamps, RELATION_GAP_S))
    metrics += found.metrics()
    errors = relation_errors(run.trajectory.stamps_ns, run.trajectory.poses, relations)
    details.setdefault("errors", {})["relations"] = worst_relations(relations, errors)


class _Mapped(NamedTuple):
    """The map's part of a judgement; `R_t_g` where it was aligned."""

    metrics: list[Metric]
    R_t_g: Array | None = None
    placed: PlacedModel | None = None
    findings: MapFindings | None = None
    by_trajectory: bool = False


_MAP_GROUPS = ("map nees", "corners", "walls", "doors", "areas", "topology", "occupancy")


def _map(run: Run, given: Given, reasons: dict[str, str], details: dict[str, Any]) -> _Mapped:
    reference = given.reference
    if reference is None and given.grid is None:
        reasons.update(dict.fromkeys(_MAP_GROUPS, "no reference map was given"))
        return _Mapped([])
    if run.model is None:
        reasons.update(dict.fromkeys(_MAP_GROUPS, "the run has no model"))
        return _Mapped([])
    reference = reference or ReferenceMap()
    alignment = _aligned(run, run.model, given, reference)
    details["alignment"] = alignment.document()
    if alignment.R_t_g is None:
        reasons.update(dict.fromkeys(_MAP_GROUPS, alignment.reason))
        return _Mapped([])
    by_trajectory = alignment.by == "trajectory" and given.truth is not None
    poses = compose(alignment.R_t_g, run.trajectory.poses)
    if by_trajectory and given.truth is not None:
        poses = given.truth.poses
    reference = with_visits(reference, poses) if "rooms" in given.names else reference
    placed = place(run.model, alignment.R_t_g)
    findings = compare_maps(placed, reference, poses, run.view, given.grid)
    for group, part, wanted in (
        ("corners", findings.corners, "walls"),
        ("walls", findings.walls, "walls or furniture"),
        ("doors", findings.doors, "doors"),
        ("areas", findings.areas, "areas"),
        ("topology", findings.topology, "areas with doors between them"),
        ("occupancy", findings.occupancy, "map of cells"),
    ):
        if part is None:
            reasons[group] = f"the reference has no {wanted}"
    return _Mapped(
        list(findings.metrics()), alignment.R_t_g, placed, findings, by_trajectory=by_trajectory
    )


def _warnings(
    run: Run, given: Given, mapped: _Mapped, reasons: Mapping[str, str]
) -> tuple[str, ...]:
    """That a truth is of a small part of the run, and that a reference map was given in vain."""
    stamps_ns = run.trajectory.stamps_ns
    warnings: list[str | None] = []
    if given.truth is not None:
        name = _name(given, "trajectory")
        warnings.append(trajectory_warning(name, stamps_ns, given.truth.stamps_ns))
    if given.relations is not None:
        warnings.append(relations_warning(_name(given, "relations"), stamps_ns, given.relations))
    if not mapped.metrics and not (given.reference is None and given.grid is None):
        name = given.names.get("reference", "the reference map")
        why = "it has nothing to measure" if mapped.placed is not None else reasons["walls"]
        warnings.append(f"{name}: nothing was measured on this map: {why}")
    return tuple(warning for warning in warnings if warning is not None)


def _aligned(
    run: Run, model: HierarchicalModel, given: Given, reference: ReferenceMap
) -> Alignment:
    """By the trajectory where it lies in the reference's frame, else by the maps."""
    from hiermap_cli.evaluation.evidence import model_points, raster_of_grid, raster_of_reference

    if given.truth is not None and in_frame(given.truth.poses, reference, given.grid):
        best = ate(run.trajectory.stamps_ns, run.trajectory.poses, *given.truth)
        return Alignment(best.alignment, "trajectory")
    raster = raster_of_reference(reference) if given.grid is None else raster_of_grid(given.grid)
    track = run.trajectory.poses[:: max(1, len(run.trajectory.poses) // 500), :2]
    return align_by_maps(model_points(place(model, np.zeros(3)), track), raster)


def in_frame(poses: Array, reference: ReferenceMap, grid: OccupancyGrid | None) -> bool:
    """Whether a trajectory (N, 3) lies on the ground of the reference, so that their frame is one.

    It is believed where the reference does not say what is ground.
    """
    points = poses[:: max(1, len(poses) // 1000), :2]
    if grid is not None:
        at, exists = grid.cells(points)
        at[~exists] = 0
        return bool((grid.free[at[:, 0], at[:, 1]] & exists).mean() >= _INSIDE)
    if not reference.areas:
        return True
    import shapely

    from hiermap_cli.evaluation.areas import shape

    ground = shapely.union_all([shape(area.polygon) for area in reference.areas]).buffer(0.3)
    return bool(shapely.contains_xy(ground, points[:, 0], points[:, 1]).mean() >= _INSIDE)


def with_visits(reference: ReferenceMap, poses: Array) -> ReferenceMap:
    """The reference with its areas and doors marked as visited by a trajectory (N, 3) in its frame.

    A door was visited where both its areas were.
    """
    import shapely

    from hiermap_cli.evaluation.areas import shape

    areas = tuple(
        replace(
            area,
            visited=bool(shapely.contains_xy(shape(area.polygon), poses[:, 0], poses[:, 1]).any()),
        )
        for area in reference.areas or ()
    )
    seen = {area.id for area in areas if area.visited}
    doors = tuple(replace(door, visited=set(door.areas) <= seen) for door in reference.doors or ())
    return replace(
        reference,
        areas=areas if reference.areas is not None else None,
        doors=doors if reference.doors is not None else None,
    )


def _nees(run: Run, given: Given, mapped: _Mapped, reasons: dict[str, str]) -> dict[str, Nees]:
    """The NEES of robot, landmarks and areas, those that can be asked for."""
    if given.truth is None:
        why = "no reference trajectory was given"
    elif len(run.trajectory.covariances) == 0:
        why = "the run has no trajectory_covariance.txt"
    else:
        estimate = (run.trajectory.stamps_ns, run.trajectory.poses)
        R_t_g = first_pose_alignment(*estimate, *given.truth)
        if R_t_g is not None:
            found = {"nees_robot": robot_nees(run.trajectory, *given.truth)}
            if mapped.R_t_g is not None and mapped.by_trajectory and run.model is not None:
                known = given.reference or ReferenceMap()
                found["nees_landmarks"] = landmark_nees(run.model, known, R_t_g, mapped.R_t_g)
                found["nees_areas"] = area_nees(run.model, known, R_t_g, mapped.R_t_g)
            elif mapped.R_t_g is not None:
                reasons["map nees"] = "the trajectory does not lie in the reference map's frame"
            return found
        why = "no pose of the run lies within the reference trajectory's time"
    reasons["nees"] = why
    reasons.setdefault("map nees", why)
    return {}
