"""A hierarchical model laid over a reference map: its parts in the reference's frame t."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry.se2 import compose, compose_D_first, compose_D_second, rotation, wrap
from hiermap_cli.mapping.model import SegmentFeature

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hiermap_cli.mapping.model import HierarchicalModel, LandmarkModel

    Array = NDArray[np.float64]


def move_points(R_t_g: Array, points: Array) -> Array:
    """Points (..., 2) of frame g seen from frame t."""
    return np.asarray(points, dtype=float) @ rotation(R_t_g[2]).T + R_t_g[:2]


class PlacedPoints(NamedTuple):
    """k landmarks that are points: ids, positions (k, 2), covariances (k, 2, 2), in one frame.

    headings: (k,) of their X axes there.
    """

    ids: tuple[str, ...]
    points: Array
    covariances: Array
    headings: Array

    def moved(self, R_t_g: Array) -> PlacedPoints:
        """The same seen from t; the transform itself is exact."""
        turn = rotation(R_t_g[2])
        return PlacedPoints(
            self.ids,
            move_points(R_t_g, self.points),
            turn @ self.covariances @ turn.T,
            np.asarray(wrap(self.headings + R_t_g[2])),
        )


@dataclass(frozen=True, slots=True)
class PlacedDoor:
    """A door of the environment model: its two areas, centre (2,), and whether it was crossed."""

    id: str
    areas: tuple[str, str]
    centre: Array
    crossed: bool


@dataclass(frozen=True, slots=True)
class PlacedArea:
    """An area of the model with its extent (m, 2)."""

    id: str
    polygon: Array


@dataclass(frozen=True, slots=True)
class PlacedModel:
    """Corners, landmark segments (s, 2, 2) as end points, doors and areas, in frame t.

    owners: (s,) id of the landmark that each segment belongs to.
    """

    corners: PlacedPoints
    segments: Array
    doors: tuple[PlacedDoor, ...]
    areas: tuple[PlacedArea, ...]
    owners: tuple[str, ...] = ()


def is_corner(landmark: LandmarkModel) -> bool:
    """Corners of either kind that bind their position."""
    return landmark.kind.startswith("corner") and {"x", "y"} <= set(landmark.binds)


def is_door(landmark: LandmarkModel) -> bool:
    """Door landmarks that bind their position."""
    return landmark.kind == "door" and {"x", "y"} <= set(landmark.binds)


def landmark_points(model: HierarchicalModel, chosen: Iterable[LandmarkModel]) -> PlacedPoints:
    """Origins in g of landmarks, their covariance through area frame and landmark.

    `C = J1 C(R_g_a) J1' + J2 C(R_a_l) J2'` for `R_g_l = compose(R_g_a, R_a_l)` (equation 2); the
    model holds no correlation between an area's frame in g and a landmark in the area.
    """
    frames = dict(model.environment.areas)
    poses = {(area.id, l): estimate for area in model.areas for l, estimate in area.landmarks}
    listed = list(chosen)
    if not listed:
        return PlacedPoints((), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0))
    R_g_a = [frames[landmark.area] for landmark in listed]
    R_a_l = [poses[landmark.area, landmark.id] for landmark in listed]
    first, second = (np.array([one.mean for one in part]) for part in (R_g_a, R_a_l))
    C_g_a, C_a_l = (np.array([one.covariance for one in part]) for part in (R_g_a, R_a_l))
    J1, J2 = compose_D_first(first, second)[:, :2], compose_D_second(first, second)[:, :2]
    C = J1 @ C_g_a @ J1.transpose(0, 2, 1) + J2 @ C_a_l @ J2.transpose(0, 2, 1)
    ids = tuple(landmark.id for landmark in listed)
    poses_g = compose(first, second)
    return PlacedPoints(ids, poses_g[:, :2], C, poses_g[:, 2])


def place(model: HierarchicalModel, R_t_g: Array) -> PlacedModel:
    """All of a model that is judged, seen from the reference's frame t.

    `R_t_g` (3,) is the model's global frame in t, for instance `ate(...).alignment`.
    """
    R_g_a = {area: estimate.mean for area, estimate in model.environment.areas}
    R_a_l = {(area.id, l): estimate.mean for area in model.areas for l, estimate in area.landmarks}
    segments: list[Array] = []
    owners: list[str] = []
    for landmark in model.landmarks:
        R_t_l = compose(R_t_g, compose(R_g_a[landmark.area], R_a_l[landmark.area, landmark.id]))
        own = [
            move_points(R_t_l, feature.endpoints)
            for feature in landmark.features
            if isinstance(feature, SegmentFeature)
        ]
        segments += own
        owners += [landmark.id] * len(own)
    return PlacedModel(
        corners=landmark_points(model, filter(is_corner, model.landmarks)).moved(R_t_g),
        segments=np.array(segments).reshape(-1, 2, 2),
        doors=tuple(
            PlacedDoor(
                door.id,
                door.areas,
                move_points(R_t_g, door.estimate.mean[:2]),
                door.crossings > 0,
            )
            for door in model.environment.doors
        ),
        areas=tuple(
            PlacedArea(area.id, move_points(compose(R_t_g, R_g_a[area.id]), area.extent))
            for area in model.areas
        ),
        owners=tuple(owners),
    )
