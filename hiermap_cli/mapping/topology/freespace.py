"""The free space of an area: where beams have passed, as a coarse grid, and its outline.

Every area keeps two counts a cell: scans whose beams passed through it, and scans whose beams
ended in it. The grid is as large as the area, however long the robot stays. What was seen
through a door belongs to the other side: the region of an area is what of its free cells hangs
together with the robot's path in it, without going through its doors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import raster, se2

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

CELL = 0.1  # metres
PAD = 32  # cells by which a grid grows at least
SHORT = 0.15  # metres before a beam's end at which free space ends: the end is not sharp
STEP = 0.1  # metres between the samples of a beam
ENOUGH = 255


class Region(NamedTuple):
    """Cells of an area: mask (w, h), index (x, y) of its first cell; x = CELL (i + first)."""

    mask: Mask
    first: tuple[int, int]

    def contains(self, point: Array) -> bool:
        """Whether a point (2,) lies in it."""
        i, j = (np.floor(np.asarray(point) / CELL).astype(int) - self.first).tolist()
        w, h = self.mask.shape
        return 0 <= i < w and 0 <= j < h and bool(self.mask[i, j])

    def inside(self, points: Array) -> Mask:
        """Which of the points (n, 2) lie in it."""
        cells = np.floor(points / CELL).astype(np.int64) - self.first
        within = ((cells >= 0) & (cells < self.mask.shape)).all(axis=1)
        found = np.zeros(len(points), dtype=bool)
        found[within] = self.mask[cells[within, 0], cells[within, 1]]
        return found

    def area(self) -> float:
        """Square metres."""
        return float(np.count_nonzero(self.mask)) * CELL**2

    def trimmed(self) -> Region:
        """The region without the rows and columns about it that are empty."""
        if not self.mask.any():
            return Region(self.mask[:0, :0], self.first)
        i, j = np.flatnonzero(self.mask.any(axis=1)), np.flatnonzero(self.mask.any(axis=0))
        mask = self.mask[i[0] : i[-1] + 1, j[0] : j[-1] + 1]
        return Region(mask, (self.first[0] + int(i[0]), self.first[1] + int(j[0])))

    def bounds(self) -> Array:
        """The least and greatest x, y (2, 2) that its cells may have, metres."""
        return CELL * (np.array([(0, 0), self.mask.shape]) + self.first)

    def centres(self) -> Array:
        """Centres (n, 2) of its cells, metres."""
        return np.asarray(CELL * (np.argwhere(self.mask) + self.first + 0.5), dtype=float)


@dataclass(slots=True)
class FreeGrid:
    """Counts of an area's cells, in its frame. passed, ended: (w, h) uint8, saturating."""

    passed: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0), np.uint8))
    ended: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0), np.uint8))
    first: tuple[int, int] = (0, 0)
    scans: int = 0

    def add(self, origin: Array, ends: Array) -> None:
        """A scan: beams from `origin` (2,) to `ends` (n, 2) in the area's frame."""
        if not len(ends):
            return
        x0, y0 = (origin / CELL).tolist()
        x, y = (ends / CELL).T
        self._grow(
            (math.floor(min(x.min(), x0)), math.floor(min(y.min(), y0))),
            (math.floor(max(x.max(), x0)), math.floor(max(y.max(), y0))),
        )
        i0, j0 = self.first
        x, y, x0, y0 = x - i0, y - j0, x0 - i0, y0 - j0
        dx, dy = x - x0, y - y0
        length = np.sqrt(dx * dx + dy * dy)
        samples = np.maximum((length - SHORT / CELL) * (CELL / STEP), 0.0).astype(np.int64)
        step = (STEP / CELL) / np.maximum(length, 1e-9)
        dx *= step
        dy *= step
        # Sample k of all, being number k - first of its beam, lies that many steps and a half out.
        first = np.cumsum(samples) - samples - 0.5
        beam = np.repeat(np.arange(len(samples)), samples)
        k = np.arange(len(beam), dtype=float)
        free_x = k * dx.take(beam) + (x0 - first * dx).take(beam)
        free_y = k * dy.take(beam) + (y0 - first * dy).take(beam)
        _count(self.passed, free_x.astype(np.int64), free_y.astype(np.int64))
        _count(self.ended, x.astype(np.int64), y.astype(np.int64))
        self.scans += 1

    def _grow(self, low: tuple[int, int], high: tuple[int, int]) -> None:
        """So large that the cells from `low` to `high` are in it."""
        if not self.passed.size:
            self.first = (low[0] - PAD // 2, low[1] - PAD // 2)
        before, after = [0, 0], [0, 0]
        for k in (0, 1):
            last = self.first[k] + self.passed.shape[k]
            before[k] = self.first[k] - low[k] + PAD if low[k] < self.first[k] else 0
            after[k] = high[k] - last + PAD if high[k] >= last else 0
        if any(before) or any(after):
            pad = tuple(zip(before, after, strict=True))
            self.passed, self.ended = np.pad(self.passed, pad), np.pad(self.ended, pad)
            self.first = (self.first[0] - before[0], self.first[1] - before[1])

    def free(self) -> Mask:
        """Cells that beams have passed and at most few have ended in, (w, h)."""
        return (self.passed > 0) & (2 * self.ended.astype(np.int64) <= self.passed)

    def bounds(self) -> Array:
        """The least and greatest x, y (2, 2) that its cells may have, metres."""
        return CELL * (np.array([(0, 0), self.passed.shape]) + self.first)

    def moved(self, R_b_a: Array) -> FreeGrid:
        """The grid in another frame, from which the present one is seen as `R_b_a`."""
        w, h = self.passed.shape
        if not w * h:
            return FreeGrid()
        corners = CELL * (np.array(self.first) + np.array([[0, 0], [w, 0], [0, h], [w, h]]))
        at = _moved(R_b_a, corners) / CELL
        low, high = np.floor(at.min(axis=0)).astype(int), np.ceil(at.max(axis=0)).astype(int)
        x, y = (np.arange(a, b) + 0.5 for a, b in zip(low.tolist(), high.tolist(), strict=True))
        # Where each cell of the new grid comes from.
        back = se2.invert(R_b_a)
        c, s = np.cos(back[2]), np.sin(back[2])
        i = np.floor(back[0] / CELL - self.first[0] + c * x[:, None] - s * y).astype(np.int64)
        j = np.floor(back[1] / CELL - self.first[1] + s * x[:, None] + c * y).astype(np.int64)
        inside = (i >= 0) & (i < w) & (j >= 0) & (j < h)
        taken = i[inside] * h + j[inside]
        out = FreeGrid(first=(int(low[0]), int(low[1])), scans=self.scans)
        for name in ("passed", "ended"):
            counts = np.zeros(inside.shape, np.uint8)
            counts[inside] = getattr(self, name).ravel()[taken]
            setattr(out, name, counts)
        return out

    def joined(self, other: FreeGrid) -> FreeGrid:
        """The counts of both, in one frame."""
        if not other.passed.size:
            return self
        out = FreeGrid(self.passed, self.ended, self.first, self.scans + other.scans)
        (i, j), (w, h) = other.first, other.passed.shape
        out._grow((i, j), (i + w - 1, j + h - 1))
        i, j = i - out.first[0], j - out.first[1]
        for name in ("passed", "ended"):
            counts = getattr(out, name).astype(np.int64)
            counts[i : i + w, j : j + h] += getattr(other, name)
            setattr(out, name, np.minimum(counts, ENOUGH).astype(np.uint8))
        return out

    def region(
        self, path: Array, barriers: Iterable[Array], width: float, reach: float | None = None
    ) -> Region:
        """What of the free cells hangs together with the path (k, 2), not across a barrier.

        barriers: segments (2, 2); where they part the path, its larger part counts. Where the
        free space is narrower than `width` metres it ends, unless the path goes on there: so
        what is seen through a door that the robot did not use stays outside. Nothing is told
        of what lies farther than `reach` metres outside the path's bounds.
        """
        if not len(path) or not self.passed.size:
            return Region(np.zeros((0, 0), dtype=bool), self.first)
        if reach is not None:
            return self._about(path, reach).region(path, barriers, width)
        free = self.free()
        at = self._cells(path)
        free[at[:, 0], at[:, 1]] = True  # whatever beams have ended there: the robot has not
        for segment in barriers:
            cells = self._cells(_along(segment))
            for i, j in ((0, 0), (1, 0), (0, 1)):  # so thick that no diagonal leads through
                x = np.minimum(cells[:, 0] + i, free.shape[0] - 1)
                free[x, np.minimum(cells[:, 1] + j, free.shape[1] - 1)] = False
        radius = 0.5 * width / CELL
        wide = raster.shrunk(free, radius)
        way = np.zeros_like(free)
        way[at[:, 0], at[:, 1]] = True
        labels = raster.pieces(wide | (way & free), diagonal=True)
        visits = np.bincount(labels[at[:, 0], at[:, 1]])
        visits[0] = 0
        if not visits.any():
            return Region(np.zeros_like(free), self.first)
        core = labels == int(np.argmax(visits))
        near = free & raster.grown(core, radius + 0.5)
        labels = raster.pieces(near)  # again not across a barrier
        mine = np.zeros(labels.max() + 1, dtype=bool)
        mine[labels[core & near]] = True
        return Region(mine[labels], self.first)

    def _about(self, path: Array, reach: float) -> FreeGrid:
        """The part of the grid that lies within `reach` metres of the bounds of a path."""
        low = np.floor((path.min(axis=0) - reach) / CELL).astype(int) - self.first
        high = np.ceil((path.max(axis=0) + reach) / CELL).astype(int) - self.first
        (i, j), (k, m) = np.maximum(low, 0).tolist(), high.tolist()
        first = (self.first[0] + i, self.first[1] + j)
        return FreeGrid(self.passed[i:k, j:m], self.ended[i:k, j:m], first, self.scans)

    def _cells(self, points: Array) -> Index:
        cells = np.floor(points / CELL).astype(np.int64) - self.first
        return cells[((cells >= 0) & (cells < self.passed.shape)).all(axis=1)]


def _count(counts: NDArray[np.uint8], i: Index, j: Index) -> None:
    """One more for each of these cells, however often it is named; `counts` is changed."""
    flat = counts.reshape(-1)
    at = i * counts.shape[1] + j
    now = flat.take(at)
    flat[at] = now + (now < ENOUGH)  # of a cell named twice the same is written twice


def _along(segment: Array) -> Array:
    steps = max(2, int(np.hypot(*(segment[1] - segment[0])) / (0.3 * CELL)))
    way: Array = segment[1] - segment[0]
    points: Array = segment[0] + np.linspace(0.0, 1.0, steps)[:, None] * way
    return points


def _moved(R_b_a: Array, points: Array) -> Array:
    c, s = np.cos(R_b_a[2]), np.sin(R_b_a[2])
    out: Array = R_b_a[:2] + points @ np.array([[c, s], [-s, c]])
    return out


def closed(region: Region, gap: float, block: float = np.inf, barred: Mask | None = None) -> Region:
    """The largest piece of a region, without its small holes.

    Gaps up to `gap` metres wide, as between furniture, are taken for free. A hole wider than that
    stays one if it is larger than `block` square metres: no furniture, but what an area goes round.
    barred: cells (w, h) that are none of its own whatever is closed.
    """
    if not region.mask.any():
        return region
    radius = 0.5 * gap / CELL
    pad = int(radius) + 2
    grid = np.pad(region.mask, pad)
    bridged = grid | raster.shrunk(raster.grown(grid, radius), radius)
    if barred is not None:
        bridged &= ~np.pad(barred, pad)
    whole = raster.filled(bridged)
    holes = raster.pieces(whole & ~bridged)
    size = np.bincount(holes.ravel()) * CELL**2
    large = size > block
    large[0] = False
    if barred is not None:
        theirs = np.bincount(holes.ravel(), np.pad(barred, pad).ravel())
        whole &= ~(2.0 * theirs * CELL**2 > size)[holes] | (holes == 0)
    if large.any():
        wide = np.unique(holes[raster.shrunk(large[holes], radius)])
        blocks = np.isin(holes, wide[wide > 0])
        whole &= ~blocks
    return Region(raster.largest(whole), (region.first[0] - pad, region.first[1] - pad))


def half_width(region: Region) -> float:
    """Radius of the largest circle inside a region, metres; 0 without cells."""
    return CELL * raster.depth(region.mask)


def wider_than(region: Region, width: float) -> bool:
    """Whether a circle wider than `width` metres fits into a region."""
    return bool(raster.shrunk(np.pad(region.mask, 1), 0.5 * width / CELL).any())
