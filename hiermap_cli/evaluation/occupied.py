"""A model against a map of cells: `occupancy_agreement` and `free_agreement` of formats.md."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.areas import shape
from hiermap_cli.evaluation.evidence import along_segments
from hiermap_cli.evaluation.measures import measured, ratio
from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.documents.occupancy import OccupancyGrid
    from hiermap_cli.evaluation.placed import PlacedModel

    Array = NDArray[np.float64]

NEAR = 0.2  # metres from a wall to an occupied cell that bears it out
_STEP = 0.05  # metres between the points of a wall that are asked
_GRID = 0.1  # metres between the points of an area that are asked


class OccupancyMetrics(NamedTuple):
    """Shares of the model that a map of cells bears out; nan where the model has nothing.

    walls, free: of all landmark segments' length, and of the model's area. points, squares: how
    many points were asked for each. by_segment: (s,) share of each landmark segment. by_area: share
    of each area's ground, None of one without an extent.
    """

    walls: float
    free: float
    points: int
    squares: int
    by_segment: Array
    by_area: tuple[tuple[str, float | None], ...]

    def metrics(self) -> tuple[Metric, ...]:
        """The figures under the names of eval.json, those that could be measured."""
        return measured(
            Metric("occupancy_agreement", "1", self.walls, self.points),
            Metric("free_agreement", "1", self.free, self.squares),
        )


def occupancy_metrics(model: PlacedModel, grid: OccupancyGrid) -> OccupancyMetrics:
    """Landmark segments within 0.2 m of an occupied cell, and areas on free cells.

    A wall's distance is to the nearest point of a cell, not to its centre: points are spread over
    the edges of the cells on the outside of what is occupied. Ground that the map does not know is
    not free.
    """
    from scipy.spatial import KDTree

    points, _ = along_segments(model.segments, _STEP)
    owner = _owner(model.segments)
    inside = _lookup(grid, points, grid.occupied)
    tree = KDTree(_outline(grid))
    apart, _ = tree.query(points, distance_upper_bound=NEAR + grid.resolution)
    near = inside | (apart <= NEAR)
    counts = np.bincount(owner, None, len(model.segments))
    hits = np.bincount(owner, near, len(model.segments))
    length = np.hypot(*(model.segments[:, 1] - model.segments[:, 0]).T)
    shares = hits / np.maximum(counts, 1)
    areas = [(area.id, _free_share(grid, area.polygon)) for area in model.areas]
    asked = sum(n for _, (_, n) in areas)
    return OccupancyMetrics(
        walls=ratio(float((shares * length).sum()), float(length.sum())),
        free=ratio(sum(free for _, (free, _) in areas), asked),
        points=len(points),
        squares=asked,
        by_segment=shares,
        by_area=tuple((id_, free / n if n else None) for id_, (free, n) in areas),
    )


def _owner(segments: Array) -> NDArray[np.int64]:
    """Which segment each point of `along_segments` belongs to."""
    span = segments[:, 1] - segments[:, 0]
    counts = np.maximum(np.ceil(np.hypot(span[:, 0], span[:, 1]) / _STEP).astype(int), 1)
    return np.repeat(np.arange(len(segments)), counts)


def _lookup(grid: OccupancyGrid, points: Array, cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether points (n, 2) lie in cells of a mask."""
    at, exists = grid.cells(points)
    at[~exists] = 0
    return np.asarray(cells[at[:, 0], at[:, 1]] & exists)


def _outline(grid: OccupancyGrid) -> Array:
    """Points (k, 2) along the edges between occupied cells and others, in the map's frame."""
    share = (np.arange(4) + 0.5) / 4.0
    padded = np.pad(grid.occupied, 1)
    row, column = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    upright = np.stack(np.broadcast_arrays(column[:, None], row[:, None] + share), axis=-1)
    row, column = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    level = np.stack(np.broadcast_arrays(column[:, None] + share, row[:, None]), axis=-1)
    return grid.to_map(np.concatenate((upright.reshape(-1, 2), level.reshape(-1, 2))).astype(float))


def _free_share(grid: OccupancyGrid, polygon: Array) -> tuple[float, int]:
    """Points of an area that are free, and points of it in all."""
    import shapely

    ground = shape(polygon)
    if ground.is_empty or not math.isfinite(ground.area) or ground.area == 0.0:
        return 0.0, 0
    x1, y1, x2, y2 = ground.bounds
    x, y = np.meshgrid(
        np.arange(x1, x2, _GRID) + 0.5 * _GRID, np.arange(y1, y2, _GRID) + 0.5 * _GRID
    )
    points = np.column_stack((x.ravel(), y.ravel()))
    points = points[shapely.contains_xy(ground, points[:, 0], points[:, 1])]
    return float(_lookup(grid, points, grid.free).sum()), len(points)
