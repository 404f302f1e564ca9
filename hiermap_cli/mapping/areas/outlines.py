"""The outline of a region: one polygon that is simple, though the region may have holes.

An area may go round something: a block of rooms within a ring of corridors. Its outline is one
ring of points all the same; every hole is opened to the outside by a slit, one cell wide, where
it is nearest to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import raster
from hiermap_cli.mapping.topology.freespace import CELL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.topology.freespace import Region

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

AT_ONCE = 1_000_000  # distances, or pairs of edges, that are held at a time
CHAMFER = 0.25  # cells cut off a corner at which two cells only touch


def outline(region: Region, detail: float) -> Array:
    """The boundary (m, 2) of a region of one piece, counterclockwise, in its frame.

    Simplified by `detail` metres, but nowhere so far that it would cross or touch itself; empty,
    (0, 2), without cells.
    """
    if not region.mask.any():
        return np.zeros((0, 2))
    mask = slit(np.pad(region.mask, 1))
    ring = CELL * (_boundary(mask) + np.array(region.first) - 1.0)
    return simplified(ring, detail)


def slit(mask: Mask) -> Mask:
    """A mask with empty borders, of one piece, every hole of which is open to the outside.

    Slits are one cell wide, at the narrowest place; the nearest hole is opened first.
    """
    mask = mask.copy()
    while True:
        empty = raster.pieces(~mask)
        if empty.max() <= 1:
            return mask
        # Cells beside the mask: of the outside (1) and of all holes.
        rim = np.argwhere(raster.grown(mask, 1.0) & ~mask)
        of = empty[rim[:, 0], rim[:, 1]]
        outside, holes = rim[of == 1], rim[of > 1]
        a, b = _nearest(holes, outside)
        for i, j in _stairs(a, b):
            mask[i, j] = False
        mask = raster.largest(mask)


def _nearest(a: Index, b: Index) -> tuple[tuple[int, int], tuple[int, int]]:
    """The two cells of (n, 2) and (m, 2) that are nearest to each other."""
    best, found = np.inf, (0, 0)
    many = max(1, AT_ONCE // len(b))
    for first in range(0, len(a), many):
        d = a[first : first + many, None] - b
        d2 = (d * d).sum(axis=2)
        i, j = divmod(int(d2.argmin()), len(b))
        if d2[i, j] < best:
            best, found = d2[i, j], (first + i, j)
    (i, j), (k, m) = a[found[0]].tolist(), b[found[1]].tolist()
    return (i, j), (k, m)


def _stairs(a: tuple[int, int], b: tuple[int, int]) -> list[tuple[int, int]]:
    """Cells from one to another, each beside the last, along the straight line."""
    (i, j), (k, m) = a, b
    up, right = np.sign(k - i), np.sign(m - j)
    cells = [(i, j)]
    n, o = abs(k - i), abs(m - j)
    x = y = 0
    while x < n or y < o:
        # The next side of the cell that the line goes through.
        if ((x + 0.5) * o <= (y + 0.5) * n and x < n) or y >= o:
            x += 1
        else:
            y += 1
        cells.append((i + int(up) * x, j + int(right) * y))
    return cells


def _boundary(mask: Mask) -> Array:
    """Points (n, 2) along the boundary of one piece of cells without holes, in order."""
    i, j = np.nonzero(mask)
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    padded = np.pad(mask, 1)
    # Each side of a cell that has nothing beyond it, run through with the cell on the left.
    for di, dj, start, stop in (
        (0, -1, (0, 0), (1, 0)),
        (1, 0, (1, 0), (1, 1)),
        (0, 1, (1, 1), (0, 1)),
        (-1, 0, (0, 1), (0, 0)),
    ):
        open_ = ~padded[i + 1 + di, j + 1 + dj]
        for a, b in zip(i[open_].tolist(), j[open_].tolist(), strict=True):
            key = (a + start[0], b + start[1])
            edges.setdefault(key, []).append((a + stop[0], b + stop[1]))
    first = min(edges)
    loop, at = [first], edges[first].pop()
    before = first
    while at != first:
        loop.append(at)
        ways = edges[at]
        # Where two cells touch at a corner only, turn left: the piece stays one.
        way = 0
        if len(ways) > 1:
            d = (at[0] - before[0], at[1] - before[1])
            left = (at[0] - d[1], at[1] + d[0])
            way = ways.index(left) if left in ways else 0
        before, at = at, ways.pop(way)
    return _chamfered(np.array(loop, dtype=float))


def _chamfered(ring: Array) -> Array:
    """A ring of cells' corners that visits none twice: such corners are cut off a little."""
    _, of, visits = np.unique(ring, axis=0, return_inverse=True, return_counts=True)
    twice = visits[of.reshape(-1)] > 1
    if not twice.any():
        return ring
    before = ring + CHAMFER * (np.roll(ring, 1, axis=0) - ring)
    after = ring + CHAMFER * (np.roll(ring, -1, axis=0) - ring)
    both = np.stack((np.where(twice[:, None], before, ring), after), axis=1)
    keep = np.column_stack((np.ones(len(ring), dtype=bool), twice))
    return np.asarray(both[keep])


def simplified(ring: Array, detail: float) -> Array:
    """A closed ring (n, 2) with no more points than needed to stay within `detail` metres.

    A ring that nowhere meets itself still does so nowhere: where an edge would cross or touch
    another one, more of its points are kept.
    """
    if len(ring) < 4:
        return ring
    far = int(np.argmax(np.hypot(*(ring - ring[0]).T)))
    kept = np.zeros(len(ring) + 1, dtype=bool)
    closed_ring = np.vstack((ring, ring[:1]))
    kept[: far + 1] = _thinned(closed_ring[: far + 1], detail)
    kept[far:] |= _thinned(closed_ring[far:], detail)
    kept = kept[:-1]
    while True:
        index = np.flatnonzero(kept)
        stop = np.append(index[1:], len(ring))
        crossed = _crossed(ring[index]) & (stop - index > 1)
        if not crossed.any():
            return np.asarray(ring[index])
        for a, b in zip(index[crossed].tolist(), stop[crossed].tolist(), strict=True):
            kept[a + 1 + _farthest(closed_ring[a : b + 1])[0]] = True


def _crossed(ring: Array) -> Mask:
    """Which edges (n,) of a closed ring meet another one that is not beside them."""
    n = len(ring)
    found = np.zeros(n, dtype=bool)
    a, b = ring, np.roll(ring, -1, axis=0)
    low, high = np.minimum(a, b), np.maximum(a, b)
    many = max(1, AT_ONCE // n)
    for first in range(0, n, many):
        some = slice(first, first + many)
        meet = (low[some, None] <= high).all(axis=2) & (low <= high[some, None]).all(axis=2)
        i, j = np.nonzero(meet)
        i += first
        apart = (j - i) % n
        far = (apart > 1) & (apart < n - 1)
        i, j = i[far], j[far]
        s1, s2 = _side(a[i], b[i], a[j]), _side(a[i], b[i], b[j])
        s3, s4 = _side(a[j], b[j], a[i]), _side(a[j], b[j], b[i])
        found[i[(s1 * s2 <= 0.0) & (s3 * s4 <= 0.0)]] = True
    return found


def _side(a: Array, b: Array, point: Array) -> Array:
    """On which side of the lines from a to b (n, 2) points (n, 2) lie: 0 on them."""
    d, e = b - a, point - a
    cross = d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]
    return np.where(np.abs(cross) < 1e-9, 0.0, np.sign(cross))


def _thinned(line: Array, detail: float) -> Mask:
    """Which points of an open line Douglas and Peucker's thinning keeps."""
    keep = np.zeros(len(line), dtype=bool)
    keep[[0, -1]] = True
    waiting = [(0, len(line) - 1)]
    while waiting:
        a, b = waiting.pop()
        if b - a < 2:
            continue
        i, off = _farthest(line[a : b + 1])
        if off > detail:
            keep[a + 1 + i] = True
            waiting += [(a, a + 1 + i), (a + 1 + i, b)]
    return keep


def _farthest(line: Array) -> tuple[int, float]:
    """Which point between the first and the last is farthest from their chord, and how far."""
    chord = line[-1] - line[0]
    d = line[1:-1] - line[0]
    span = float(np.hypot(*chord))
    off = np.hypot(*d.T) if span < 1e-9 else np.abs(d @ [-chord[1], chord[0]]) / span
    i = int(np.argmax(off))
    return i, float(off[i])
