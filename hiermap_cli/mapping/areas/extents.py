"""Where the areas are: the free space of each within its doors, its outline, its kind by shape.

An area also sees into others, through doors that the robot did not use there. Ground that two
areas have seen belongs to the one in which the robot came nearer to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from hiermap_cli.geometry import raster, se2
from hiermap_cli.mapping.areas.outlines import outline
from hiermap_cli.mapping.topology.freespace import (
    CELL,
    FreeGrid,
    Region,
    closed,
    half_width,
    wider_than,
)
from hiermap_cli.mapping.topology.places import door_barriers

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import AreaConfig
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.areas.common_ground import Bars
    from hiermap_cli.mapping.areas.rooms import Rooms
    from hiermap_cli.mapping.topology.places import Places

    Array = NDArray[np.float64]

AreaKind = Literal["room", "corridor", "unknown"]

QUARTERS = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
TOGETHER = 100_000  # distances that are held at a time


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
    bars: Bars | None = None,
) -> list[Extent]:
    """The extents of all areas, in their frames, in the order of `rooms.parts`.

    R_0_p: for each area (k, 3), its parts' frames, in which the filter ran, in its own frame.
    frames: (n, 3) the areas' frames in g. bars: all doors, where they part every area and not only
    those that they join.
    """
    grounds = []
    for parts, R, frame in zip(rooms.parts, R_0_p, frames, strict=True):
        grid, way = _seen(parts, R, rooms, places)
        if bars is None:
            barriers = [
                _moved(R_0, b)
                for part, R_0 in zip(parts, R, strict=True)
                for b in door_barriers(part, areas[part], rooms.portals)
            ]
        else:
            barriers = bars.within(frame, grid.bounds())
        # Of cells turned into another frame the quarters: no two that touch come apart.
        quarters = (way[:, None] + 0.25 * CELL * QUARTERS).reshape(-1, 2)
        region = grid.region(quarters, barriers, config.opening).trimmed()
        grounds.append(Ground(entered(region, way, places.widest_door, config.min_area), way))
    near = _neighbours(grounds, frames)
    regions = [ground.region for ground in grounds]
    for _ in range(2):
        # What is parted from an area in the first round stays the others', who have seen it too.
        regions = [
            _own(i, grounds, regions, frames, np.flatnonzero(near[i]).tolist(), config)
            for i in range(len(grounds))
        ]
    return [
        Extent(outline(region, config.outline), area_kind(region, config)) for region in regions
    ]


def _own(
    i: int,
    grounds: Sequence[Ground],
    regions: Sequence[Region],
    frames: Array,
    others: Sequence[int],
    config: AreaConfig,
) -> Region:
    """An area's region without what is another's. regions: where each may be at most."""
    ground = grounds[i]
    lost = np.zeros_like(ground.region.mask)
    for j in others:
        R = se2.between(frames[j], frames[i])
        cells = _lost(ground, Ground(regions[j], grounds[j].path), R)
        lost[cells[:, 0], cells[:, 1]] = True
    own = Region(ground.region.mask & ~lost, ground.region.first)
    return closed(own, config.furniture, config.min_area, lost)


def entered(region: Region, path: Array, width: float, least: float) -> Region:
    """A region as far as the robot was in it: path (k, 2).

    A place as large as an area, `least` square metres, behind an opening no wider than `width`
    metres, a door's, is another area if the path does not lead there: one that was only seen.
    """
    if not region.mask.any():
        return region
    radius = 0.5 * width / CELL
    deep = raster.shrunk(np.pad(region.mask, 1), radius)[1:-1, 1:-1]
    places = raster.pieces(deep, diagonal=True)
    way = np.zeros_like(region.mask)
    cells = np.floor(path / CELL).astype(np.int64) - region.first
    cells = cells[((cells >= 0) & (cells < way.shape)).all(axis=1)]
    way[cells[:, 0], cells[:, 1]] = True
    visited = places[raster.grown(way, radius)]
    left = region.mask.copy()
    for k in np.setdiff1d(places, np.append(visited, 0)).tolist():
        place = raster.grown(places == k, radius + 0.5) & region.mask
        if np.count_nonzero(place) * CELL**2 >= least:
            left &= ~place
    return Region(left, region.first)


def _neighbours(grounds: Sequence[Ground], frames: Array) -> NDArray[np.bool_]:
    """Which regions (n, n) may share cells: those whose circles about their bounds meet."""
    bounds = [ground.region.bounds() for ground in grounds]
    middle = [
        _moved(frame, b.mean(axis=0)[None])[0] for frame, b in zip(frames, bounds, strict=True)
    ]
    radius = np.array([0.5 * np.hypot(*(b[1] - b[0])) for b in bounds])
    between = np.array(middle)[:, None] - np.array(middle)
    near = np.hypot(between[..., 0], between[..., 1]) <= radius[:, None] + radius
    near &= ~np.eye(len(grounds), dtype=bool)
    return np.asarray(near)


def _seen(
    parts: Sequence[int], R_0_p: Array, rooms: Rooms, places: Places
) -> tuple[FreeGrid, Array]:
    """The free space and the path (k, 2) of an area's parts, in its frame."""
    grid, path = FreeGrid(), []
    for part, R in zip(parts, R_0_p, strict=True):
        if part in places.grids:
            grid = grid.joined(places.grids[part].moved(R))
        own = places.path(part) if rooms.paths is None else rooms.paths[part]
        path.append(_moved(R, own))
    return grid, np.concatenate(path)


def _lost(ground: Ground, other: Ground, R_other_this: Array) -> NDArray[np.int64]:
    """Cells (n, 2) of a region to which the robot came nearer in another, whose frame is given."""
    here = ground.region.centres()
    there = _moved(R_other_this, here)
    contested = other.region.inside(there)
    if not contested.any():
        return np.zeros((0, 2), dtype=np.int64)
    nearer = _distance2(there[contested], other.path) < _distance2(here[contested], ground.path)
    return np.argwhere(ground.region.mask)[contested][nearer]


def _distance2(points: Array, path: Array) -> Array:
    """Square metres: the distance from points (n, 2) to the nearest of a path (k, 2), squared."""
    nearest = np.empty(len(points))
    many = max(1, TOGETHER // len(path))
    for first in range(0, len(points), many):
        some = points[first : first + many]
        d2 = (path * path).sum(axis=1) - 2.0 * (some @ path.T)
        nearest[first : first + many] = d2.min(axis=1) + (some * some).sum(axis=1)
    return nearest


def area_kind(region: Region, config: AreaConfig) -> AreaKind:
    """A corridor is narrow everywhere, and long; a room is not; too small an area is unknown."""
    if region.area() < config.min_area:
        return "unknown"
    if wider_than(region, config.corridor_width):
        return "room"
    width = 2.0 * half_width(region)
    long = region.area() > config.corridor_length * width**2
    return "corridor" if long and width < config.corridor_width else "room"


def _moved(R: Array, points: Array) -> Array:
    moved: Array = se2.compose(R, np.column_stack((points, np.zeros(len(points)))))[:, :2]
    return moved
