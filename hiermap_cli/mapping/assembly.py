"""The final result of a run, put together from what the filters left."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.errors import InputError
from hiermap_cli.estimation import motion as odometry_model
from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import WALL
from hiermap_cli.mapping.landmarks import AreaLandmarks, area_landmarks
from hiermap_cli.mapping.levels import Levels, compose_levels
from hiermap_cli.mapping.metrics import metric
from hiermap_cli.mapping.model import (
    AreaModel,
    DoorModel,
    EnvironmentModel,
    Estimate,
    Event,
    HierarchicalModel,
    LandmarkModel,
    MapResult,
    Metric,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.mapper import Mapper

    Array = NDArray[np.float64]


def assemble(mapper: Mapper) -> MapResult:
    """The three levels and the trajectory of a mapper that has taken in the whole log.

    Raises:
        InputError: it has not taken in a single scan.
    """
    if not mapper.areas:
        raise InputError("the log holds no scan to map; `hiermap inspect` shows what it holds")
    mapper.finish()
    levels = compose_levels(mapper)
    doors = _doors(mapper, levels)
    areas, landmarks = _areas(mapper, levels, doors)
    return MapResult(
        model=HierarchicalModel(_environment(levels, doors), areas, landmarks),
        trajectory=levels.trajectory,
        trajectory_filter=levels.trajectory,
        events=_events(mapper, doors),
        metrics=_metrics(mapper),
        timing={},
        dropped={},
    )


def _areas(
    mapper: Mapper, levels: Levels, doors: dict[int, DoorModel]
) -> tuple[tuple[AreaModel, ...], tuple[LandmarkModel, ...]]:
    areas: list[AreaModel] = []
    landmarks: list[LandmarkModel] = []
    entered: dict[int, str | None] = {}
    for i, portal in enumerate(mapper.portals):
        entered.setdefault(portal.b, doors[i].id if i in doors else None)
    for i, V in enumerate(levels.maps):
        id_ = f"A{i + 1}"
        found: AreaLandmarks = area_landmarks(V, mapper.areas[i].features, id_, 1 + len(landmarks))
        C = found.covariance
        areas.append(
            AreaModel(
                id=id_,
                kind="unknown",
                entered_by=entered.get(i),
                robot=Estimate(id_, V.robot, C[:3, :3]),
                landmarks=tuple(
                    (
                        landmark.id,
                        Estimate(id_, pose, C[3 * k + 3 : 3 * k + 6, 3 * k + 3 : 3 * k + 6]),
                    )
                    for k, (landmark, pose) in enumerate(
                        zip(found.landmarks, found.poses, strict=True)
                    )
                ),
                covariance=C,
                extent=_hull(_seen_points(mapper, levels, i)),
            )
        )
        landmarks.extend(found.landmarks)
    return tuple(areas), tuple(landmarks)


def _seen_points(mapper: Mapper, levels: Levels, i: int) -> Array:
    """Where the robot was in the area and where its walls end, (m, 2)."""
    trail = mapper.trail
    here = np.flatnonzero(np.array(trail.area) == i)
    poses = np.array([trail.poses[k] for k in here]).reshape(-1, 3)
    points = [se2.between(levels.shifts[i], poses)[:, :2]]
    f = mapper.areas[i].features
    walls = np.flatnonzero(f.kind == WALL)
    for along in (f.lo[walls], f.hi[walls]):
        offset = np.column_stack((along, 0 * along, 0 * along))
        points.append(se2.compose(levels.maps[i].poses[1 + walls], offset)[:, :2])
    return np.concatenate(points)


def _hull(points: Array) -> Array:
    """Convex hull (m, 2), counterclockwise; a small square about points that span no area."""
    points = np.unique(points, axis=0)
    halves = []
    for ordered in (points, points[::-1]):
        chain: list[Array] = []
        for p in ordered:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0.0:
                chain.pop()
            chain.append(p)
        halves.append(chain[:-1])
    hull = np.array(halves[0] + halves[1]).reshape(-1, 2)
    if len(hull) >= 3:
        return hull
    return points.mean(axis=0) + 0.1 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _doors(mapper: Mapper, levels: Levels) -> dict[int, DoorModel]:
    """The portals that are doors, by their index: where an area merely grew too large is none."""
    doors: dict[int, DoorModel] = {}
    for i, portal in enumerate(mapper.portals):
        if portal.wall <= 0.0:
            continue
        V, f = levels.maps[portal.a], mapper.areas[portal.a].features
        k = 1 + int(np.flatnonzero(f.uid == portal.anchor_a)[0])
        anchor = se2.compose(levels.frames[portal.a], V.poses[k])
        pose = se2.compose(anchor, portal.R_anchor_d)
        T = V.invariant_D_error(V.poses[k])
        Ad = se2.adjoint(levels.frames[portal.a])
        where = V.columns(k)
        C = levels.frame_covariance(portal.a)
        C = C + Ad @ T @ V.covariance[where, where] @ T.T @ Ad.T
        J = se2.additive_D_invariant(pose)
        doors[i] = DoorModel(
            id=f"D{len(doors) + 1}",
            areas=(f"A{portal.a + 1}", f"A{portal.b + 1}"),
            landmarks=(),
            width=portal.width,
            estimate=Estimate("g", pose, symmetrise(J @ C @ J.T)),
            crossings=portal.crossings,
        )
    return doors


def _environment(levels: Levels, doors: dict[int, DoorModel]) -> EnvironmentModel:
    poses = np.vstack((levels.robot, levels.frames))
    J = np.zeros_like(levels.covariance)
    for i, block in enumerate(se2.additive_D_invariant(poses)):
        J[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    C = symmetrise(J @ levels.covariance @ J.T)
    return EnvironmentModel(
        robot=Estimate("g", levels.robot, C[:3, :3]),
        areas=tuple(
            (f"A{i + 1}", Estimate("g", F, C[3 * i + 3 : 3 * i + 6, 3 * i + 3 : 3 * i + 6]))
            for i, F in enumerate(levels.frames)
        ),
        covariance=C,
        doors=tuple(doors.values()),
    )


def _events(mapper: Mapper, doors: dict[int, DoorModel]) -> tuple[Event, ...]:
    """The mapper's events, with the doors' final ids."""
    names = {f"D{i + 1}": door.id for i, door in doors.items()}
    events = []
    for event in mapper.events:
        details = dict(event.details)
        if "door" in details:
            details["door"] = names.get(details["door"])
        events.append(Event(event.stamp_ns, event.kind, details))
    return tuple(events)


def _metrics(mapper: Mapper) -> tuple[Metric, ...]:
    """What only the estimator knows of the run."""
    n, scans = mapper.counts, len(mapper.trail.stamps_ns)
    entries = sum(portal.crossings for portal in mapper.portals)
    parameters = mapper.area.V.parameters
    calibration = (
        ("odometry_scale_translation", 1.0 + parameters[odometry_model.SCALE]),
        ("odometry_scale_rotation", 1.0 + parameters[odometry_model.ROTATION_SCALE]),
        ("odometry_curvature", parameters[odometry_model.CURVATURE]),
        ("laser_x", parameters[odometry_model.LASER_X]),
    )
    metrics = [
        metric("scans_processed", n.keys, scans),
        metric("matches", n.matched, n.matched),
        metric("matching_failures", n.failed, n.keys),
        metric("areas_reentered", entries - len(mapper.portals), entries + 1),
        *(metric(name, value, n.keys) for name, value in calibration),
    ]
    if n.degrees and n.nis > 0.0:
        metrics.append(metric("nis_mean", n.nis / n.degrees, n.keys))
    return tuple(metrics)
