"""How far the cells of a raster lie from walls, and which wall is nearest, as far as it matters.

Beyond some reach nothing asks for a wall. Up to there its squared distance is the least over the
shifts that lead to one, along one axis and then along the other (Saito and Toriwaki 1994), in
integers of few bytes: faster than an unbounded transform, and nothing heavy to import for it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Integers = NDArray[np.int64]


def distance_to(at: Integers, size: tuple[int, int], cell: float, reach: float) -> Array:
    """Metres (H, W) from the middle of each cell to that of the nearest one of some cells.

    Args:
        at: (n, 2) row and column of those cells.
        size: rows and columns of the raster.
        cell: metres.
        reach: metres; what lies farther is at infinity.
    """
    cells = math.floor(reach / cell + 1e-9)
    metres = np.sqrt(np.arange(cells**2 + 2)) * cell
    metres[-1] = math.inf
    return np.asarray(metres[_least(at, np.zeros(len(at), np.int64), size, cells, 1)])


def nearest_to(at: Integers, size: tuple[int, int], reach: int) -> Integers:
    """Which of the cells (n, 2) lies nearest to each cell (H, W); -1 where none does.

    The first of those that are as near; none is farther than `reach` cells.
    """
    count = max(1, len(at))
    found = _least(at, np.arange(len(at)), size, reach, count)
    return np.where(found < (reach**2 + 1) * count, found % count, -1)


def _least(
    at: Integers, values: Integers, size: tuple[int, int], reach: int, unit: int
) -> Integers:
    """Least `unit` times squared distance plus value (H, W); the distance `reach`^2 + 1 if far."""
    far = (reach**2 + 1) * unit
    least = np.full(size, far, dtype=np.min_scalar_type(-2 * far))
    np.minimum.at(least.reshape(-1), at @ (size[1], 1), values.astype(least.dtype))
    for _ in range(2):
        before, least = least, least.copy()
        for k in range(1, reach + 1):
            farther = before + before.dtype.type(k**2 * unit)
            np.minimum(least[k:], farther[:-k], out=least[k:])
            np.minimum(least[:-k], farther[k:], out=least[:-k])
        # Along columns as along rows: what lies behind another in memory is fastest.
        least = np.ascontiguousarray(least.T)
    return least
