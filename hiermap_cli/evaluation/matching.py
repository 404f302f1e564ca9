"""One-to-one matching of things found with things that are there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Pairs = NDArray[np.int64]


def match_points(
    found: Array, true: Array, radius: float, allowed: NDArray[np.bool_] | None = None
) -> Pairs:
    """Pairs (k, 2) of indices: as many as possible within `radius`, then least total distance.

    Args:
        found: (n, 2) points.
        true: (m, 2) points in the same frame.
        radius: metres, inclusive.
        allowed: (n, m) which may be pairs at all; all where it is not given.
    """
    if len(found) == 0 or len(true) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    distance = np.hypot(*np.moveaxis(found[:, None, :] - true[None, :, :], -1, 0))
    near = distance <= radius if allowed is None else (distance <= radius) & allowed
    pairs: list[tuple[int, int]] = []
    for rows, columns in _components(near):
        part, fits = distance[np.ix_(rows, columns)], near[np.ix_(rows, columns)]
        # One more match always outweighs whatever distance it costs the others.
        penalty = (radius + 1.0) * (min(part.shape) + 1)
        cost = np.where(fits, part, penalty)
        pairs += [(rows[i], columns[j]) for i, j in assigned(cost) if fits[i, j]]
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


def _components(near: NDArray[np.bool_]) -> list[tuple[list[int], list[int]]]:
    """Rows and columns (n, m) that hang together by pairs that are near."""
    left = set(np.flatnonzero(near.any(axis=1)).tolist())
    out = []
    for row in sorted(left):
        if row not in left:
            continue
        rows, columns = {row}, set(np.flatnonzero(near[row]).tolist())
        while True:
            more = set(np.flatnonzero(near[:, sorted(columns)].any(axis=1)).tolist())
            if more == rows:
                break
            rows = more
            columns = set(np.flatnonzero(near[sorted(rows)].any(axis=0)).tolist())
        left -= rows
        out.append((sorted(rows), sorted(columns)))
    return out


def assigned(cost: Array) -> list[tuple[int, int]]:
    """The assignment of least total cost: pairs of row and column, as many as the lesser of both.

    The Hungarian method by shortest augmenting paths (Jonker and Volgenant 1987). Written here
    because loading scipy's takes longer than all matching of a building.
    """
    if cost.shape[0] > cost.shape[1]:
        return sorted((i, j) for j, i in assigned(cost.T))
    n, m = cost.shape
    if n == 1:
        return [(0, int(np.argmin(cost[0])))]
    u, v = np.zeros(n), np.zeros(m)
    row_of = np.full(m, -1)
    for row in range(n):
        # Dijkstra over columns from `row`; `before` is the column by which each was reached.
        shortest, before = cost[row] - u[row] - v, np.full(m, -1)
        done = np.zeros(m, dtype=bool)
        while True:
            column = int(np.argmin(np.where(done, np.inf, shortest)))
            done[column] = True
            if row_of[column] < 0:
                break
            other = int(row_of[column])
            through = shortest[column] + cost[other] - u[other] - v
            better = ~done & (through < shortest)
            shortest[better], before[better] = through[better], column
        reached = done.copy()
        reached[column] = False
        least = shortest[column]
        u[row] += least
        u[row_of[reached]] += least - shortest[reached]
        v[reached] -= least - shortest[reached]
        while before[column] >= 0:
            row_of[column] = row_of[before[column]]
            column = int(before[column])
        row_of[column] = row
    return sorted((int(i), j) for j, i in enumerate(row_of.tolist()) if i >= 0)


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
