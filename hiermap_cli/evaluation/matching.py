"""One-to-one matching of things found with things that are there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Pairs = NDArray[np.int64]


def match_points(found: Array, true: Array, radius: float) -> Pairs:
    """Pairs (k, 2) of indices: as many as possible within `radius`, then least total distance.

    Args:
        found: (n, 2) points.
        true: (m, 2) points in the same frame.
        radius: metres, inclusive.
    """
    if len(found) == 0 or len(true) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    from scipy.optimize import linear_sum_assignment

    distance = np.hypot(*np.moveaxis(found[:, None, :] - true[None, :, :], -1, 0))
    near = distance <= radius
    # One more match always outweighs whatever distance it costs the others.
    penalty = (radius + 1.0) * (min(distance.shape) + 1)
    rows, columns = linear_sum_assignment(np.where(near, distance, penalty))
    kept = near[rows, columns]
    return np.column_stack((rows[kept], columns[kept])).astype(np.int64)


def match_largest(score: Array, allowed: NDArray[np.bool_]) -> Pairs:
    """Pairs (k, 2) taken from the largest score (n, m) downwards, each row and column once."""
    pairs = []
    rows, columns = np.nonzero(allowed)
    order = np.lexsort((columns, rows, -score[rows, columns]))
    free_rows = np.ones(score.shape[0], dtype=bool)
    free_columns = np.ones(score.shape[1], dtype=bool)
    for i, j in zip(rows[order], columns[order], strict=True):
        if free_rows[i] and free_columns[j]:
            pairs.append((i, j))
            free_rows[i] = free_columns[j] = False
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)
