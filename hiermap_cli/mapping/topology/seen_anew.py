"""The free space of every area made again, seen from better poses than the filter had."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.topology.freespace import CELL, FreeGrid
from hiermap_cli.mapping.topology.places import Places

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.topology.looks import Looks

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


def seen_from(looks: Looks, poses: Array, frames: Array, widest_door: float) -> Places:
    """The free space and the path of every area, as seen from these poses.

    Args:
        looks: what was seen.
        poses: (K, 3) of all key scans in g.
        frames: (A, 3) of all areas in g, in which their free space is wanted.
        widest_door: metres.
    """
    places = Places(widest_door)
    X = se2.between(frames[looks.area], poses[looks.key])
    of_path = _path(X, looks.area)
    of_look = looks.area[looks.look]
    at = X[looks.look]
    c, s = np.cos(at[:, 2]), np.sin(at[:, 2])
    turn = np.stack((np.stack((c, s), axis=1), np.stack((-s, c), axis=1)), axis=1)
    origins = at[:, :2] + np.einsum("ni,nij->nj", looks.origin, turn)
    beam = np.repeat(np.arange(len(at)), np.diff(looks.first))
    ends = at[beam, :2] + np.einsum("ni,nij->nj", looks.ends, turn[beam])
    for area in np.unique(looks.area).tolist():
        places.paths[area] = of_path[area]
        here = np.flatnonzero(of_look == area).tolist()
        if here:
            grid = places.grids[area] = FreeGrid()
            for i in here:
                grid.add(origins[i], ends[looks.first[i] : looks.first[i + 1]])
    return places


def _path(X: Array, area: Index) -> dict[int, set[tuple[int, int]]]:
    """Of each area the cells on the way from pose to pose (n, 3) in it."""
    start = X[:, :2].copy()
    start[1:] = np.where((area[1:] == area[:-1])[:, None], X[:-1, :2], X[1:, :2])
    way = X[:, :2] - start
    steps = 1 + (np.hypot(way[:, 0], way[:, 1]) / (0.5 * CELL)).astype(np.int64)
    of = np.repeat(np.arange(len(X)), steps + 1)
    k = np.arange(len(of)) - np.repeat(np.cumsum(steps + 1) - steps - 1, steps + 1)
    points = start[of] + (k / steps[of])[:, None] * way[of]
    cells = np.unique(np.column_stack((area[of], np.floor(points / CELL).astype(np.int64))), axis=0)
    found = {}
    for a in np.unique(area).tolist():
        found[a] = {(i, j) for _, i, j in cells[cells[:, 0] == a].tolist()}
    return found
