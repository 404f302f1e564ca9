"""A small building with thick walls, and the model of it that has no error."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import shapely

from hiermap_cli.documents.reference import ReferenceArea, ReferenceDoor, ReferenceMap
from hiermap_cli.documents.tum import TimedPoses
from hiermap_cli.geometry.se2 import between, compose, invert
from hiermap_cli.mapping.model import (
    AreaModel,
    DoorModel,
    EnvironmentModel,
    Estimate,
    HierarchicalModel,
    LandmarkModel,
    SegmentFeature,
    Trajectory,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SIGMA = 0.02  # of every pose, metres and radians
COVARIANCE = np.eye(3) * SIGMA**2

# Two rooms of 4 m x 3 m and a corridor of 8.2 m x 2 m along both; walls 0.2 m thick.
ROOMS = {"A1": (0.0, 0.0, 4.0, 3.0), "A2": (4.2, 0.0, 8.2, 3.0), "A3": (0.0, 3.2, 8.2, 5.2)}
KINDS = {"A1": "room", "A2": "room", "A3": "corridor"}
# Doors: id -> areas, p1 and p2 in the middle of the wall.
DOORS = {
    "D1": (("A1", "A2"), (4.1, 1.0), (4.1, 1.9)),
    "D2": (("A1", "A3"), (1.0, 3.1), (2.0, 3.1)),
}
DOOR_BOXES = ((4.0, 1.0, 4.2, 1.9), (1.0, 3.0, 2.0, 3.2))
# Where each area sees them, with headings: Y leads out of the area.
DOOR_FACES = {
    "A1": ((4.0, 1.45, -0.5 * np.pi), (1.5, 3.0, 0.0)),
    "A2": ((4.2, 1.45, 0.5 * np.pi),),
    "A3": ((1.5, 3.2, np.pi),),
}
# Frames: the model's global frame in the reference's, and the areas' frames there.
R_t_g = np.array([2.0, 1.0, 0.7])
R_t_a = {
    "A1": np.array([2.0, 1.0, 0.7]),
    "A2": np.array([4.2, 1.4, -0.4]),
    "A3": np.array([1.5, 3.2, 1.6]),
}


def box(x1: float, y1: float, x2: float, y2: float) -> Array:
    return np.array([[x1, y1], [x2, y1], [x2, y2], [x1, y2]])


def reference_map() -> ReferenceMap:
    """The building; its walls are the faces that bound the free space."""
    free = shapely.union_all(
        [shapely.Polygon(box(*b)) for b in (*ROOMS.values(), *DOOR_BOXES)], grid_size=1e-6
    )
    ring = np.array(free.exterior.coords)
    return ReferenceMap(
        walls=np.hstack((ring[:-1], ring[1:])),
        furniture=np.zeros((0, 4)),
        doors=tuple(
            ReferenceDoor(name, areas, np.array(p1), np.array(p2), visited=True)
            for name, (areas, p1, p2) in DOORS.items()
        ),
        areas=tuple(
            ReferenceArea(name, KINDS[name], box(*bounds), visited=True)
            for name, bounds in ROOMS.items()
        ),
    )


def true_path() -> TimedPoses:
    """Through all three areas, ten times a second, looking where it goes."""
    corners = np.array(
        [(2, 1), (3, 1.45), (6, 1.45), (6.5, 2), (3.5, 1.45), (1.5, 2), (1.5, 4.2), (7, 4.2)]
    )
    pieces = []
    for a, b in itertools.pairwise(corners):
        share = np.linspace(0, 1, 20, endpoint=False)[:, None]
        heading = np.arctan2(*(b - a)[::-1])
        pieces.append(np.hstack((a + share * (b - a), np.full((20, 1), heading))))
    poses = np.concatenate(pieces)
    return TimedPoses(np.arange(len(poses)) * 100_000_000, poses)


def exact_trajectory() -> Trajectory:
    truth = true_path()
    poses = compose(invert(R_t_g), truth.poses)
    return Trajectory(truth.stamps_ns, poses, np.tile(COVARIANCE, (len(poses), 1, 1)))


def exact_model() -> HierarchicalModel:
    """Corners with their walls, door landmarks, doors and areas, where they truly are."""
    walls = reference_map().walls
    assert walls is not None
    landmarks: list[LandmarkModel] = []
    areas = []
    for name, bounds in ROOMS.items():
        inside = shapely.box(*bounds).buffer(1e-3)
        poses = []
        for i, wall in enumerate(walls):
            before = walls[i - 1]
            if inside.contains(shapely.Point(wall[:2])):
                landmark = corner(f"L{len(landmarks) + 1}", name, before, wall)
                landmarks.append(landmark[0])
                poses.append((landmark[0].id, landmark[1]))
        for face in DOOR_FACES[name]:
            pose = np.array(face)
            landmarks.append(bare_landmark(f"L{len(landmarks) + 1}", name, "door", ()))
            poses.append((landmarks[-1].id, pose))
        areas.append(
            AreaModel(
                id=name,
                kind="room",
                entered_by=None,
                robot=estimate(name, np.zeros(3)),
                landmarks=tuple(
                    (l, estimate(name, between(R_t_a[name], pose))) for l, pose in poses
                ),
                covariance=np.zeros((3 + 3 * len(poses), 3 + 3 * len(poses))),
                extent=to_frame(R_t_a[name], box(*bounds)),
            )
        )
    return HierarchicalModel(environment(), tuple(areas), tuple(landmarks))


def environment() -> EnvironmentModel:
    return EnvironmentModel(
        robot=estimate("g", np.zeros(3)),
        areas=tuple((name, estimate("g", between(R_t_g, R_t_a[name]))) for name in ROOMS),
        covariance=np.zeros((12, 12)),
        doors=tuple(
            DoorModel(
                id=name,
                areas=areas,
                landmarks=(),
                width=0.9,
                estimate=door_estimate(0.5 * (np.array(p1) + np.array(p2))),
                crossings=1,
            )
            for name, (areas, p1, p2) in DOORS.items()
        ),
    )


def door_estimate(centre: Array) -> Estimate:
    """A door at a point of the reference's frame, in g."""
    return estimate("g", between(R_t_g, np.array([*centre, 0.0])))


def estimate(frame: str, mean: Array) -> Estimate:
    return Estimate(frame, mean, COVARIANCE)


def to_frame(R_t_f: Array, points: Array) -> Array:
    poses = np.column_stack((points, np.zeros(len(points))))
    return between(R_t_f, poses)[:, :2]


def corner(name: str, area: str, first: Array, second: Array) -> tuple[LandmarkModel, Array]:
    """A corner of two walls that meet, and its pose in the reference's frame."""
    along = second[2:] - second[:2]
    pose = np.array([*second[:2], np.arctan2(along[1], along[0])])
    features = tuple(
        SegmentFeature(
            p=0.0,
            q=0.0,
            line_type=1,
            covariance=np.zeros((2, 2)),
            endpoints=to_frame(pose, wall.reshape(2, 2)),
            endless=(False, False),
        )
        for wall in (first, second)
    )
    return bare_landmark(name, area, "corner_concave", features), pose


def bare_landmark(
    name: str, area: str, kind: str, features: tuple[SegmentFeature, ...]
) -> LandmarkModel:
    size = 3 + 2 * len(features)
    return LandmarkModel(
        id=name,
        area=area,
        kind=kind,
        binds=("x", "y", "theta"),
        robot=estimate(name, np.zeros(3)),
        features=features,
        covariance=np.zeros((size, size)),
        observations=3,
        utility=1.0,
    )


def without_area(model: HierarchicalModel, gone: str) -> HierarchicalModel:
    """The model as if an area, its landmarks and its doors had never been found."""
    env = model.environment
    return HierarchicalModel(
        replace(
            env,
            areas=tuple(area for area in env.areas if area[0] != gone),
            doors=tuple(door for door in env.doors if gone not in door.areas),
        ),
        tuple(area for area in model.areas if area.id != gone),
        tuple(landmark for landmark in model.landmarks if landmark.area != gone),
    )


def with_extent(model: HierarchicalModel, area: str, polygon: Array) -> HierarchicalModel:
    """The model with another extent of one area, given in the reference's frame."""
    return replace(
        model,
        areas=tuple(
            replace(a, extent=to_frame(R_t_a[area], polygon)) if a.id == area else a
            for a in model.areas
        ),
    )


def with_doors(model: HierarchicalModel, doors: tuple[DoorModel, ...]) -> HierarchicalModel:
    return replace(model, environment=replace(model.environment, doors=doors))
