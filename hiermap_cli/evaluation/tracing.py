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
    from scipy.ndimage import binary_dilation

    outline = shapely.simplify(cells_as_polygon(grid.occupied), _STRAIGHT).boundary
    lines = [np.array(part.coords) for part in shapely.get_parts(outline)]
    sides = [np.hstack((line[:-1], line[1:])) for line in lines]
    segments = np.concatenate(sides) if sides else np.zeros((0, 4))
    span = segments[:, 2:] - segments[:, :2]
    segments = segments[np.hypot(span[:, 0], span[:, 1]) >= _SHORTEST]
    near = binary_dilation(grid.free, iterations=2)
    points = segments[:, :2, None] + (segments[:, 2:] - segments[:, :2])[:, :, None] * _SHARES
    row = np.clip(points[:, 1].astype(int), 0, near.shape[0] - 1)
    column = np.clip(points[:, 0].astype(int), 0, near.shape[1] - 1)
    facing = near[row, column].mean(axis=1) >= 0.5
    return grid.to_map(segments[facing].reshape(-1, 2)).reshape(-1, 4)


_SHARES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
