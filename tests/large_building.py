"""A building of many rooms along corridors, and the model of it that has no error."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.documents.reference import ReferenceArea, ReferenceDoor, ReferenceMap
from hiermap_cli.geometry.se2 import between
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

W, D, C = 4.0, 5.0, 2.0  # metres: width and depth of a room, width of a corridor
SIGMA = 0.02


def box(x1: float, y1: float, x2: float, y2: float) -> Array:
    return np.array([[x1, y1], [x2, y1], [x2, y2], [x1, y2]])


def boxes(rows: int, columns: int) -> dict[str, tuple[str, Array]]:
    """Kind and outline of each area: `columns` rooms on both sides of each of `rows` corridors.

    Rooms differ in width, so that no shift brings the building onto itself.
    """
    out: dict[str, tuple[str, Array]] = {}
    edges = np.concatenate(([0.0], np.cumsum(W + 0.07 * np.arange(columns) % 0.9)))
    for row in range(rows):
        y = row * (2 * D + C + 0.4)
        for side, low in (("s", y), ("n", y + D + C)):
            for k in range(columns):
                out[f"{side}{row}_{k}"] = ("room", box(edges[k], low, edges[k + 1] - 0.2, low + D))
        out[f"c{row}"] = ("corridor", box(0.0, y + D + 0.2, edges[-1] - 0.2, y + D + C - 0.2))
    return out


def reference_of(areas: dict[str, tuple[str, Array]]) -> ReferenceMap:
    walls = [np.hstack((polygon, np.roll(polygon, -1, axis=0))) for _, polygon in areas.values()]
    doors = []
    for name, (kind, polygon) in areas.items():
        if kind == "room":
            y = polygon[2, 1] + 0.1 if name[0] == "s" else polygon[0, 1] - 0.1
            x = polygon[0, 0] + 1.0
            corridor = "c" + name[1:].split("_")[0]
            doors.append(
                ReferenceDoor(
                    f"D{len(doors)}",
                    (name, corridor),
                    np.array([x, y]),
                    np.array([x + 0.9, y]),
                    visited=True,
                )
            )
    return ReferenceMap(
        walls=np.concatenate(walls),
        doors=tuple(doors),
        areas=tuple(
            ReferenceArea(name, kind, polygon, visited=True)
            for name, (kind, polygon) in areas.items()
        ),
    )


def path_through(areas: dict[str, tuple[str, Array]], a_room: int = 24) -> Trajectory:
    """A turn on the spot in the middle of each area; the stamps are a tenth of a second apart."""
    poses = []
    for _, polygon in areas.values():
        heading = np.linspace(-3.1, 3.1, a_room)
        poses.append(np.column_stack((np.tile(polygon.mean(axis=0), (a_room, 1)), heading)))
    track = np.concatenate(poses)
    stamps = np.arange(len(track), dtype=np.int64) * 100_000_000
    return Trajectory(stamps, track, np.tile(np.eye(3) * SIGMA**2, (len(track), 1, 1)))


def model_of(areas: dict[str, tuple[str, Array]], reference: ReferenceMap) -> HierarchicalModel:
    C3 = np.eye(3) * SIGMA**2
    landmarks, models, frames = [], [], []
    for name, (kind, polygon) in areas.items():
        frame = np.array([*polygon[0], 0.0])
        own = []
        for i in range(4):
            before, here, after = polygon[i - 1], polygon[i], polygon[(i + 1) % 4]
            pose = np.array([*here, np.arctan2(*(after - here)[::-1])])
            ends = between(pose, np.column_stack((np.array([before, here, after]), np.zeros(3))))
            features = tuple(
                SegmentFeature(0.0, 0.0, 1, np.zeros((2, 2)), ends[j : j + 2, :2], (False, False))
                for j in (0, 1)
            )
            id_ = f"L{len(landmarks) + 1}"
            robot = Estimate(id_, np.zeros(3), C3)
            landmarks.append(
                LandmarkModel(
                    id_, name, "corner_concave", ("x", "y", "theta"), robot, features,
                    np.diag([SIGMA**2] * 3 + [0.0] * 4), 5, 1.0,
                )
            )  # fmt: skip
            own.append((id_, Estimate(name, between(frame, pose), C3)))
        size = 3 + 3 * len(own)
        extent = between(frame, np.column_stack((polygon, np.zeros(4))))[:, :2]
        models.append(
            AreaModel(
                name, kind, None, Estimate(name, np.zeros(3), C3), tuple(own),
                np.eye(size) * SIGMA**2, extent,
            )
        )  # fmt: skip
        frames.append((name, Estimate("g", frame, C3)))
    doors = tuple(
        DoorModel(
            door.id, door.areas, (), 0.9,
            Estimate("g", np.array([*(0.5 * (door.p1 + door.p2)), 0.0]), C3), 1,
        )
        for door in reference.doors or ()
    )  # fmt: skip
    size = 3 + 3 * len(frames)
    environment = EnvironmentModel(
        Estimate("g", np.zeros(3), C3), tuple(frames), np.eye(size) * SIGMA**2, doors
    )
    return HierarchicalModel(environment, tuple(models), tuple(landmarks))
