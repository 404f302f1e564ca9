"""What two maps have in common for a search that knows nothing of how they lie to each other.

A reference, whatever it consists of, becomes a raster: how far each cell is from the nearest wall,
which wall that is, and where it is free. A model becomes points: along its walls, and over the
ground it calls free.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.areas import shape
from hiermap_cli.evaluation.near_walls import distance_to, nearest_to
from hiermap_cli.evaluation.walls import solid_segments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.documents.occupancy import OccupancyGrid
    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.evaluation.placed import PlacedModel

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]

_MARGIN = 2.0  # metres of raster around all that the reference holds
SPACING = 0.1  # metres between points along walls
FREE_SPACING = 0.25  # metres between points of free ground
BINS = 180  # of headings, over half a turn
HEADINGS = 4  # of walls, over half a turn
_SAME_WAY = np.radians(40.0)  # a wall that is turned by more is another one
_NEAREST = 0.5  # metres to a wall that may draw a point to itself
_FAR, _FAR_FACING = 3.0, 1.0  # metres to a wall at which it no longer matters how many
_HAZE = 2  # cells between free ground and the face of a wall
_SLOPE = 2.0  # cells over which walls are smoothed to tell their directions
_INSIDE = 0.2  # metres that free ground keeps from the outline of a model's area


class Raster(NamedTuple):
    """A reference as cells; row is y, column x, both upwards.

    low: (2,) corner of cell [0, 0]. cell: metres. distance: (H, W) metres from a cell's centre to
    the nearest wall, infinite beyond 3 m. facing: (HEADINGS, H, W) the same to walls of about one
    direction each, infinite beyond 1 m. free: (H, W) known to be free; None where the reference
    does not say. bare: whether free ground is known to hold no walls: where the outlines of areas
    stand for walls, furniture may be there. faces: (K, 2) points on its walls, in pieces of equal
    length, and headings: (K,) there. nearest: (H, W) index of a face in the nearest cell that has
    one, -1 where none lies within half a metre; None where faces of several walls may share a cell.
    """

    low: Array
    cell: float
    distance: Array
    facing: Array
    free: Mask | None
    bare: bool
    faces: Array
    headings: Array
    nearest: NDArray[np.int64] | None


class ModelPoints(NamedTuple):
    """A model in its own frame: walls (N, 2) and their headings (N,), free ground (M, 2).

    weights: (N,) of the walls, one on average, by the inverse root of how many go their way.
    """

    walls: Array
    headings: Array
    weights: Array
    free: Array


def raster_of_reference(reference: ReferenceMap, cell: float = 0.1) -> Raster | None:
    """A reference of lines and polygons; None where it holds nothing to align by.

    Where it has no walls, the outlines of its areas stand for them.
    """
    import shapely

    polygons = [area.polygon for area in reference.areas or ()]
    segments = solid_segments(reference)
    if not len(segments):
        sides = [np.hstack((p, np.roll(p, -1, axis=0))) for p in polygons]
        segments = np.concatenate(sides) if sides else segments
    if not len(segments):
        return None
    corners = np.concatenate((segments.reshape(-1, 2), *polygons))
    low, width, height = _frame(corners, cell)
    # Walls at round coordinates lie inside cells: on their borders the last bit would decide which
    # cell they are in.
    low -= 0.25 * cell
    points, headings = along_segments(segments.reshape(-1, 2, 2), 0.5 * cell)
    free = None
    if polygons:
        x, y = low[0] + (np.arange(width) + 0.5) * cell, low[1] + (np.arange(height) + 0.5) * cell
        free = np.zeros((height, width), dtype=bool)
        for polygon in polygons:
            first, last = polygon.min(axis=0), polygon.max(axis=0)
            rows = slice(*np.searchsorted(y, (first[1], last[1])))
            columns = slice(*np.searchsorted(x, (first[0], last[0])))
            ground = shape(polygon)
            shapely.prepare(ground)
            free[rows, columns] |= shapely.contains_xy(ground, *np.meshgrid(x[columns], y[rows]))
    bare = len(solid_segments(reference)) > 0
    raster = _raster(low, cell, (height, width), points, headings, free, bare=bare)
    at, size = _cells_of(points, low, cell), (height, width)
    return raster._replace(nearest=nearest_to(at, size, math.ceil(_NEAREST / cell)))


def _frame(points: Array, cell: float) -> tuple[Array, int, int]:
    """Lower corner, width and height in cells of a raster around points (n, 2)."""
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    width, height = (np.ceil((high - low) / cell).astype(int) + 1).tolist()
    return low, width, height


def _raster(
    low: Array,
    cell: float,
    size: tuple[int, int],
    points: Array,
    headings: Array,
    free: Mask | None,
    *,
    bare: bool,
) -> Raster:
    """A raster from points (n, 2) on walls and the walls' headings (n,) there."""
    at = _cells_of(points, low, cell)
    distance = distance_to(at, size, cell, _FAR)
    facing = np.empty((HEADINGS, *size))
    for i in range(HEADINGS):
        turned = np.remainder(headings - i * np.pi / HEADINGS + 0.5 * np.pi, np.pi)
        chosen = np.abs(turned - 0.5 * np.pi) <= _SAME_WAY
        facing[i] = distance_to(at[chosen], size, cell, _FAR_FACING)
    if free is not None:
        free = free & (distance > 0.0)
    return Raster(low, cell, distance, facing, free, bare, points, headings, None)


def _cells_of(points: Array, low: Array, cell: float) -> NDArray[np.int64]:
    """Row and column (n, 2) of points (n, 2)."""
    return ((points - low) / cell).astype(np.int64)[:, ::-1]


def raster_of_grid(grid: OccupancyGrid, cell: float = 0.1) -> Raster:
    """A map of cells: the faces of its walls, and its free cells.

    The heading of a face is across the slope of the walls, smoothed over some cells.
    """
    from scipy.ndimage import binary_dilation, gaussian_filter

    cell = max(cell, grid.resolution)
    low, width, height = _frame(grid.centres(grid.occupied | grid.free), cell)
    x, y = low[0] + (np.arange(width) + 0.5) * cell, low[1] + (np.arange(height) + 0.5) * cell
    at, exists = grid.cells(np.column_stack([axis.ravel() for axis in np.meshgrid(x, y)]))
    at[~exists] = 0
    free = (exists & grid.free[at[:, 0], at[:, 1]]).reshape(height, width)
    faces = grid.occupied & binary_dilation(grid.free, np.ones((3, 3), dtype=bool), _HAZE)
    smooth = gaussian_filter(grid.occupied.astype(float), _SLOPE * cell / grid.resolution)
    slope_y, slope_x = np.gradient(smooth)
    headings = np.arctan2(slope_y, slope_x)[faces] + 0.5 * np.pi + grid.origin[2]
    return _raster(low, cell, (height, width), grid.centres(faces), headings, free, bare=True)


def along_segments(segments: Array, spacing: float) -> tuple[Array, Array]:
    """Points (n, 2) at equal steps along segments (S, 2, 2), and the heading (n,) of each's."""
    span = segments[:, 1] - segments[:, 0]
    length = np.hypot(span[:, 0], span[:, 1])
    counts = np.maximum(np.ceil(length / spacing).astype(int), 1)
    which = np.repeat(np.arange(len(segments)), counts)
    step = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (step + 0.5) / counts[which]
    points = segments[which, 0] + share[:, None] * span[which]
    return points, np.arctan2(span[which, 1], span[which, 0])


def model_points(model: PlacedModel, track: Array) -> ModelPoints:
    """The points of a model: its landmark segments, its areas, and where the robot was (T, 2)."""
    walls, headings = along_segments(model.segments, SPACING)
    common = directions(headings, 10.0)[np.round(headings / np.pi * BINS).astype(int) % BINS]
    weights = 1.0 / np.sqrt(np.maximum(common, 1.0))
    weights /= weights.mean() if len(weights) else 1.0
    return ModelPoints(walls, headings, weights, np.concatenate((_ground(model), track)))


def directions(headings: Array, width: float) -> Array:
    """Histogram of headings without a sign, smoothed over `width` bins, (BINS,)."""
    counts = np.bincount(np.round(headings / np.pi * BINS).astype(int) % BINS, None, BINS)
    away = np.minimum(np.arange(BINS), BINS - np.arange(BINS))
    kernel = np.exp(-0.5 * (away / width) ** 2)
    return np.asarray(np.fft.irfft(np.fft.rfft(counts) * np.fft.rfft(kernel), BINS))


def _ground(model: PlacedModel) -> Array:
    """A grid of points over the areas of a model, some way inside their outlines."""
    import shapely

    inside = shapely.union_all([shape(area.polygon).buffer(-_INSIDE) for area in model.areas])
    if inside.is_empty:
        return np.zeros((0, 2))
    x1, y1, x2, y2 = inside.bounds
    x, y = np.meshgrid(np.arange(x1, x2, FREE_SPACING), np.arange(y1, y2, FREE_SPACING))
    grid = np.column_stack((x.ravel(), y.ravel()))
    return np.asarray(grid[shapely.contains_xy(inside, grid[:, 0], grid[:, 1])])
