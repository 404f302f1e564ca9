"""The final result of a run, put together from what the filters left."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.estimation import motion as odometry_model
from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.areas.doors import between_faces, door_in_g
from hiermap_cli.mapping.areas.found_areas import FoundArea, find_areas
from hiermap_cli.mapping.areas.landmarks import landmark_model
from hiermap_cli.mapping.areas.rooms import Rooms, decide
from hiermap_cli.mapping.metrics import metric
from hiermap_cli.mapping.model import (
    AreaModel,
    DoorModel,
    EnvironmentModel,
    Estimate,
    Event,
    HierarchicalModel,
    MapResult,
    Metric,
)
from hiermap_cli.mapping.trust import Trust

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.mapping.levels import Levels
    from hiermap_cli.mapping.mapper import Mapper
    from hiermap_cli.mapping.model import LandmarkModel
    from hiermap_cli.mapping.portals import Portal
    from hiermap_cli.mapping.refinement.refine import Refined

    Array = NDArray[np.float64]


def assemble(
    mapper: Mapper,
    by_filter: Levels,
    levels: Levels,
    laser_x: float = 0.0,
    refined: Refined | None = None,
) -> MapResult:
    """The three levels and the trajectory of a mapper that has taken in the whole log.

    Args:
        mapper: with its areas as they are now known.
        by_filter: the levels by the filter alone.
        levels: those of the result.
        laser_x: metres from the robot's origin ahead to the laser, as the log has it.
        refined: the solution of the whole log, if the levels are of it.
    """
    frames = se2.compose(levels.frames, se2.invert(levels.shifts))
    rooms = decide(
        mapper.areas, mapper.portals, mapper.crossings.places, frames,
        mapper.config.doors, mapper.config.areas, placed=refined is not None,
    )  # fmt: skip
    found = find_areas(mapper, levels, rooms, refined)
    doors = _doors(rooms.portals, levels, found)
    areas = tuple(_area(rooms, one, i, doors) for i, one in enumerate(found))
    landmarks = tuple(model for i, one in enumerate(found) for model in _landmarks(one, i))
    trust = Trust.of(mapper, found, by_filter.loops)
    return MapResult(
        model=HierarchicalModel(_environment(levels, found, doors), areas, landmarks),
        trajectory=levels.trajectory,
        trajectory_filter=by_filter.trajectory,
        events=_events(mapper, rooms, doors),
        metrics=(*_metrics(mapper, found, laser_x), *trust.metrics()),
        timing={},
        dropped={},
        consistency=trust.document(),
    )


def _landmarks(found: FoundArea, i: int) -> list[LandmarkModel]:
    V = found.area.map.V
    return [
        landmark_model(V, draft, found.id(k), f"A{i + 1}") for k, draft in enumerate(found.drafts)
    ]


def _area(rooms: Rooms, one: FoundArea, i: int, doors: dict[int, DoorModel]) -> AreaModel:
    id_ = f"A{i + 1}"
    parts = one.area.parts
    discovered = [
        rooms.door[k]
        for k, portal in enumerate(rooms.portals)
        if portal.b == parts[0] and portal.a not in parts
    ]
    door = discovered[0] if discovered and i > 0 else None
    entered = None if door is None else doors.get(door)
    return AreaModel(
        id=id_,
        kind=one.extent.kind,
        entered_by=None if entered is None else entered.id,
        robot=Estimate(id_, one.area.map.V.robot, one.covariance[:3, :3]),
        landmarks=tuple(
            (one.id(k), Estimate(id_, draft.pose, one.block(k)))
            for k, draft in enumerate(one.drafts)
        ),
        covariance=one.covariance,
        extent=one.extent.polygon,
    )


def _doors(
    portals: Sequence[Portal], levels: Levels, found: Sequence[FoundArea]
) -> dict[int, DoorModel]:
    """The portals that are doors, by their index: where an area merely grew too large is none."""
    number = {p: i for i, one in enumerate(found) for p in one.area.parts}
    poses, C = _additive(levels, found)
    doors: dict[int, DoorModel] = {}
    for k, portal in enumerate(portals):
        a, b = number[portal.a], number[portal.b]
        if portal.kind != "door" or a == b:
            continue
        faces = []
        for i in (a, b):
            draft = found[i].doors[k]
            at = slice(3 + 3 * i, 6 + 3 * i)
            faces.append(
                door_in_g(poses[1 + i], C[at, at], found[i].drafts[draft], found[i].block(draft))
            )
        door = between_faces(*faces)
        doors[k] = DoorModel(
            id=f"D{len(doors) + 1}",
            areas=(f"A{a + 1}", f"A{b + 1}"),
            landmarks=(found[a].id(found[a].doors[k]), found[b].id(found[b].doors[k])),
            width=door.width,
            estimate=Estimate("g", door.pose, door.covariance),
            crossings=portal.crossings,
        )
    return doors


def _additive(levels: Levels, found: Sequence[FoundArea]) -> tuple[Array, Array]:
    """Robot and areas' frames in g, (1 + k, 3), and their joint additive covariance."""
    roots = [one.area.parts[0] for one in found]
    poses = np.vstack((levels.robot, levels.frames[roots]))
    which = np.concatenate(([0], 1 + np.array(roots, dtype=np.int64)))
    columns = (3 * which[:, None] + np.arange(3)).ravel()
    J = np.zeros((len(columns), len(columns)))
    for i, block in enumerate(se2.additive_D_invariant(poses)):
        J[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    return poses, symmetrise(J @ levels.covariance[np.ix_(columns, columns)] @ J.T)


def _environment(
    levels: Levels, found: Sequence[FoundArea], doors: dict[int, DoorModel]
) -> EnvironmentModel:
    poses, C = _additive(levels, found)
    return EnvironmentModel(
        robot=Estimate("g", poses[0], C[:3, :3]),
        areas=tuple(
            (f"A{i + 1}", Estimate("g", F, C[3 * i + 3 : 3 * i + 6, 3 * i + 3 : 3 * i + 6]))
            for i, F in enumerate(poses[1:])
        ),
        covariance=C,
        doors=tuple(doors.values()),
    )


def _events(mapper: Mapper, rooms: Rooms, doors: dict[int, DoorModel]) -> tuple[Event, ...]:
    """The mapper's events, with the final ids of areas and doors."""
    door_ids = {
        f"D{k + 1}": doors[stands].id for k, stands in enumerate(rooms.door) if stands in doors
    }
    area_ids = {f"A{p + 1}": f"A{i + 1}" for i, members in enumerate(rooms.parts) for p in members}
    events = []
    for event in mapper.events:
        details = dict(event.details)
        if "door" in details:
            details["door"] = door_ids.get(details["door"])
        for key in ("area", "left"):
            if key in details:
                details[key] = area_ids[details[key]]
        events.append(Event(event.stamp_ns, event.kind, details))
    end = mapper.trail.stamps_ns[-1]
    for k, reason in rooms.refused:
        portal = mapper.portals[k]
        details = {
            "area": area_ids[f"A{portal.a + 1}"],
            "reason": reason,
            "width": portal.width,
            "wall": portal.wall,
            "open": portal.open,
            "crossings": portal.crossings,
        }
        events.append(Event(end, "door_refused", details))
    return tuple(sorted(events, key=lambda event: event.stamp_ns))


def _metrics(mapper: Mapper, found: Sequence[FoundArea], laser_x: float) -> tuple[Metric, ...]:
    """What only the estimator knows of the run."""
    n, scans = mapper.counts, len(mapper.trail.stamps_ns)
    entries = sum(portal.crossings for portal in mapper.portals)
    parameters = mapper.area.V.parameters
    calibration = (
        ("odometry_scale_translation", 1.0 + parameters[odometry_model.SCALE]),
        ("odometry_scale_rotation", 1.0 + parameters[odometry_model.ROTATION_SCALE]),
        ("odometry_curvature", parameters[odometry_model.CURVATURE]),
        ("laser_x", laser_x + parameters[odometry_model.LASER_X]),
    )
    variances = mapper.area.V.covariance.diagonal()[3 : 3 + len(parameters)]
    sigmas = tuple(
        (f"{name}_sigma", float(np.sqrt(max(variance, 0.0))))
        for (name, _), variance in zip(calibration, variances.tolist(), strict=True)
    )
    noise = (
        ("noise_odometry", mapper.noise.odometry),
        ("noise_walls", mapper.noise.walls),
        ("noise_laser", mapper.noise.laser),
    )
    events = Counter(event.kind for event in mapper.events)
    recognised, relocated = events["area_recognised"], events["relocated"]
    closed, held, refused = (
        events[kind] for kind in ("loop_closed", "loop_held_back", "loop_refused")
    )
    dropped = n.forgotten + sum(one.dropped for one in found)
    kept = sum(len(one.drafts) for one in found)
    metrics = [
        metric("scans_processed", n.keys, scans),
        metric("matches", n.matched, n.matched),
        metric("matching_failures", n.failed, n.keys),
        metric("landmarks_forgotten", dropped, kept + dropped),
        metric("areas_reentered", entries - len(mapper.portals), entries + 1),
        metric("loops_closed", recognised + closed, recognised + closed + held + refused),
        metric("loops_rejected", refused, recognised + closed + held + refused),
        metric("relocations", relocated, relocated),
        *(metric(name, value, n.keys) for name, value in (*calibration, *sigmas, *noise)),
    ]
    if n.degrees and n.nis > 0.0:
        metrics.append(metric("nis_mean", n.nis / n.degrees, n.keys))
    return tuple(metrics)
