"""From cells to lines and polygons: the outlines of masks, thinned to straight lines."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.documents.occupancy import OccupancyGrid

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]

_STRAIGHT = 1.2  # cells by which an outline of cells may differ from its line
_SHORTEST = 3.0  # cells; a shorter side of an outline is no wall


def cells_as_polygon(cells: Mask) -> Any:
    """The union of the cells (H, W) that are True as a shapely geometry, in cells, x first."""
    import shapely

    padded = np.zeros((cells.shape[0], cells.shape[1] + 2), dtype=np.int8)
    padded[:, 1:-1] = cells
    change = np.diff(padded, axis=1)
    rows, begin = np.nonzero(change == 1)
    _, end = np.nonzero(change == -1)
    return shapely.union_all(shapely.box(begin, rows, end, rows + 1))


def traced_walls(grid: OccupancyGrid) -> Array:
    """The faces of a map's walls towards free ground as segments (S, 4) in the map's frame.

    They run along the outlines of the occupied cells, straightened; of these, what does not face
    a free cell is left out.
    """
    import shapely

    outline = shapely.simplify(cells_as_polygon(grid.occupied), _STRAIGHT).boundary
    lines = [np.array(part.coords) for part in shapely.get_parts(outline)]
    sides = [np.hstack((line[:-1], line[1:])) for line in lines]
    segments = np.concatenate(sides) if sides else np.zeros((0, 4))
    span = segments[:, 2:] - segments[:, :2]
    segments = segments[np.hypot(span[:, 0], span[:, 1]) >= _SHORTEST]
    segments = segments[_facing(grid, segments)]
    return grid.to_map(segments.reshape(-1, 2)).reshape(-1, 4)


def _facing(grid: OccupancyGrid, segments: Array) -> Mask:
    """Which segments (S, 4), in cells, have free ground before them, at most some haze away.

    Asked at five places of each: behind it must be the wall.
    """
    span = segments[:, 2:] - segments[:, :2]
    normal = np.column_stack((-span[:, 1], span[:, 0])) / np.hypot(*span.T)[:, None]
    places = segments[:, None, :2] + _SHARES[:, None] * span[:, None]
    facing = np.zeros(places.shape[:2], dtype=bool)
    for side in (1.0, -1.0):
        before = side * normal[:, None]
        clear = _at(grid.occupied, places - 0.5 * before)
        for cells in _BEFORE:
            ahead = places + cells * before
            facing |= clear & _at(grid.free, ahead)
            clear &= ~_at(grid.occupied, ahead)
    return np.asarray(facing.mean(axis=1) >= 0.5)


def _at(cells: Mask, points: Array) -> Mask:
    """Whether points (..., 2), in cells, x first, lie in cells of a mask."""
    at = np.floor(points).astype(int)
    exists = ((at >= 0) & (at < cells.shape[::-1])).all(axis=-1)
    at[~exists] = 0
    return np.asarray(cells[at[..., 1], at[..., 0]] & exists)


_SHARES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
_BEFORE = (0.5, 1.5, 2.5)  # cells before a wall's face
