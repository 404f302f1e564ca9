"""Where the areas are: the free space of each within its doors, its outline, its kind by shape.

An area also sees into others, through doors that the robot did not use there. Ground that two
areas have seen belongs to the one in which the robot came nearer to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.freespace import FreeGrid, Region, closed, half_width, outline
from hiermap_cli.mapping.places import door_barriers

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import AreaConfig
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.places import Places
    from hiermap_cli.mapping.rooms import Rooms

    Array = NDArray[np.float64]

AreaKind = Literal["room", "corridor", "unknown"]


class Extent(NamedTuple):
    """Where an area is: polygon (m, 2) of the free space seen in it, and what it is by shape."""

    polygon: Array
    kind: AreaKind


class Ground(NamedTuple):
    """The region of an area, and the robot's path (k, 2) in it."""

    region: Region
    path: Array


def extents(
    rooms: Rooms,
    R_0_p: Sequence[Array],
    frames: Array,
    areas: Sequence[AreaMap],
    places: Places,
    config: AreaConfig,
) -> list[Extent]:
    """The extents of all areas, in their frames, in the order of `rooms.parts`.

    R_0_p: for each area (k, 3), its parts' frames, in which the filter ran, in its own frame.
    frames: (n, 3) the areas' frames in g.
    """
    grounds = [
        _ground(parts, R, rooms, areas, places, config)
        for parts, R in zip(rooms.parts, R_0_p, strict=True)
    ]
    found = []
    for i, ground in enumerate(grounds):
        mask = ground.region.mask.copy()
        for j, other in enumerate(grounds):
            if i != j and mask.any():
                mask &= ~_lost(ground, other, se2.between(frames[j], frames[i]))
        region = closed(Region(mask, ground.region.first), config.furniture)
        found.append(Extent(outline(region, config.outline), area_kind(region, config)))
    return found


def _ground(
    parts: Sequence[int],
    R_0_p: Array,
    rooms: Rooms,
    areas: Sequence[AreaMap],
    places: Places,
    config: AreaConfig,
) -> Ground:
    grid, path, barriers = FreeGrid(), [], []
    for part, R in zip(parts, R_0_p, strict=True):
        if part in places.grids:
            grid = grid.joined(places.grids[part].moved(R))
        path.append(_moved(R, places.path(part)))
        barriers += [_moved(R, b) for b in door_barriers(part, areas[part], rooms.portals)]
    way = np.concatenate(path)
    return Ground(grid.region(way, barriers, config.opening), way)


def _lost(ground: Ground, other: Ground, R_other_this: Array) -> NDArray[np.bool_]:
    """Cells of an area's region to which the robot came nearer in another, whose frame is given."""
    region = ground.region
    lost = np.zeros_like(region.mask)
    here = region.centres()
    there = _moved(R_other_this, here)
    contested = other.region.inside(there)
    if not contested.any():
        return lost
    cells = np.argwhere(region.mask)[contested]
    nearer = _distance(there[contested], other.path) < _distance(here[contested], ground.path)
    lost[cells[nearer, 0], cells[nearer, 1]] = True
    return lost


def _distance(points: Array, path: Array) -> Array:
    """Metres from points (n, 2) to the nearest of a path (k, 2)."""
    from scipy.spatial import KDTree

    return np.asarray(KDTree(path).query(points)[0], dtype=float)


def area_kind(region: Region, config: AreaConfig) -> AreaKind:
    """A corridor is narrow everywhere, and long; a room is not; too small an area is unknown."""
    if region.area() < config.min_area:
        return "unknown"
    width = 2.0 * half_width(region)
    long = region.area() > config.corridor_length * width**2
    return "corridor" if long and width < config.corridor_width else "room"


def _moved(R: Array, points: Array) -> Array:
    moved: Array = se2.compose(R, np.column_stack((points, np.zeros(len(points)))))[:, :2]
    return moved
