"""From regions of cells to areas and doors, and from a map of cells to a reference map.

Areas are the outlines of the regions; doors are where two of them meet.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.documents.reference import ReferenceArea, ReferenceDoor, ReferenceMap
from hiermap_cli.evaluation.tracing import cells_as_polygon, traced_walls

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.documents.occupancy import OccupancyGrid

    Array = NDArray[np.float64]
    Labels = NDArray[np.int64]

_SMALLEST = 0.5  # square metres; a smaller region is a speck
_BETWEEN = 0.35  # metres of free ground between two regions that still meet
_CORRIDOR = 3.0  # length over width from which an area is called a corridor
_STRAIGHT = 1.2  # cells by which an outline may differ from its lines


def reference_of_grid(grid: OccupancyGrid, regions: Labels | None = None) -> ReferenceMap:
    """A map of cells as a reference: its walls as lines and, with regions, areas and doors."""
    walls = traced_walls(grid)
    if regions is None:
        return ReferenceMap(walls=walls)
    rooms = reference_of_rooms(grid, regions)
    return ReferenceMap(walls=walls, doors=rooms.doors, areas=rooms.areas)


def reference_of_rooms(grid: OccupancyGrid, regions: Labels) -> ReferenceMap:
    """Areas and doors alone, of regions (H, W) numbered from 1; ids follow their numbers."""
    sizes = np.bincount(regions.ravel())
    kept = [
        number for number in range(1, len(sizes)) if sizes[number] * grid.resolution**2 >= _SMALLEST
    ]
    areas: list[ReferenceArea] = []
    names: dict[int, str] = {}
    for number in kept:
        polygon = _outline(grid, regions == number)
        names[number] = f"A{len(areas) + 1}"
        areas.append(ReferenceArea(names[number], _kind(polygon), polygon, visited=True))
    doors = [
        ReferenceDoor(f"D{i}", (names[a], names[b]), p1, p2, visited=True)
        for i, (a, b, p1, p2) in enumerate(_meetings(grid, regions, kept))
    ]
    return ReferenceMap(areas=tuple(areas), doors=tuple(doors))


def _outline(grid: OccupancyGrid, cells: NDArray[np.bool_]) -> Array:
    """The outer boundary (m, 2) of a region, straightened, without what only hangs by a corner."""
    import shapely

    rows, columns = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    row, column = int(rows[0]), int(columns[0])
    part = cells[row : rows[-1] + 1, column : columns[-1] + 1]
    pieces = shapely.get_parts(cells_as_polygon(part))
    largest = max(pieces, key=lambda piece: piece.area)
    filled = shapely.Polygon(largest.exterior)
    ring = np.array(shapely.simplify(filled, _STRAIGHT).exterior.coords)[:-1]
    return grid.to_map(ring + np.array([column, row]))


def _kind(polygon: Array) -> str:
    """A corridor is much longer than wide, by its length and area; else a room."""
    import shapely

    shape = shapely.Polygon(polygon)
    half, area = 0.5 * shape.length, shape.area
    # Sides a, b of the rectangle with the same area and length of outline.
    root = max(half**2 - 4.0 * area, 0.0) ** 0.5
    return "corridor" if half + root >= _CORRIDOR * max(half - root, 1e-9) else "room"


def _meetings(
    grid: OccupancyGrid, regions: Labels, kept: list[int]
) -> list[tuple[int, int, Array, Array]]:
    """Where two regions meet: their numbers and both ends of the line between them.

    Free cells between regions belong to the nearest one within reach, so that regions parted by a
    thin line, as segmentations draw it in doors, meet as well.
    """
    from scipy.ndimage import distance_transform_edt, label

    owned = np.where(np.isin(regions, kept), regions, 0)
    distance, nearest = distance_transform_edt(owned == 0, return_indices=True)
    reach = (distance * grid.resolution <= _BETWEEN) & (grid.free | (regions > 0))
    owned = np.where(reach, owned[nearest[0], nearest[1]], 0)
    contacts: dict[tuple[int, int], list[Array]] = {}
    for axis, step in ((0, (1, 0)), (1, (0, 1))):
        first = owned[: owned.shape[0] - step[0], : owned.shape[1] - step[1]]
        second = owned[step[0] :, step[1] :]
        at = np.argwhere((first != second) & (first > 0) & (second > 0))
        middle = at[:, ::-1] + (np.array([0.5, 1.0]) if axis == 0 else np.array([1.0, 0.5]))
        for (row, column), point in zip(at.tolist(), middle, strict=True):
            pair = sorted((int(first[row, column]), int(second[row, column])))
            contacts.setdefault((pair[0], pair[1]), []).append(point)
    found = []
    for (a, b), points in sorted(contacts.items()):
        cells = np.array(points)
        low = np.floor(cells.min(axis=0)).astype(int)
        mask = np.zeros(tuple(np.ceil(np.ptp(cells, axis=0)).astype(int)[::-1] + 2), dtype=bool)
        at = np.floor(cells).astype(int) - low
        mask[at[:, 1], at[:, 0]] = True
        labels, n = label(mask, np.ones((3, 3)))
        for k in range(1, n + 1):
            group = cells[labels[at[:, 1], at[:, 0]] == k]
            found.append((a, b, *_line(grid, group)))
    return found


def _line(grid: OccupancyGrid, cells: Array) -> tuple[Array, Array]:
    """Both ends of the contact whose points (k, 2), in cells, lie along it."""
    middle = cells.mean(axis=0)
    _, _, axes = np.linalg.svd(cells - middle, full_matrices=False)
    along = (cells - middle) @ axes[0] if len(cells) > 1 else np.zeros(1)
    direction = axes[0] if len(cells) > 1 else np.array([1.0, 0.0])
    ends = middle + np.array([along.min() - 0.5, along.max() + 0.5])[:, None] * direction
    p1, p2 = grid.to_map(ends)
    return p1, p2
