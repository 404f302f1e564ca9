"""Areas of the filter that prove to be one place, once all of them lie where they are.

The filter begins an area anew where it does not know that it has been there. With the log solved
as a whole it is known where each area lies, to centimetres: where two have seen the same ground
for the most part, or the robot's path in one lies within the other, with no door between them,
they are one.

What was seen through a door to which the robot never drove is not the area's. Between two areas
that the robot drove across from one to the other such a door is known; between others every
opening as wide as a door may be one, and ends the ground (`sure`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.topology.freespace import CELL
from hiermap_cli.mapping.topology.places import BESIDE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from hiermap_cli.mapping.topology.places import Places

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

BEYOND = 2.0  # metres of path behind a door that are no mere turn in it
BEGAN = 0.5  # metres from an area's origin, where its path begins behind a door
SQUARE = 0.2  # metres: ground of several areas is compared by such squares
WAY = 2.5  # metres of either one's path on the other's ground with which two are one place
_MANY = 1 << 31


class Ground(NamedTuple):
    """Squares of g, as sorted numbers, that an area's beams have passed, and of its path in them.

    size: square metres of its free space. way: (k, 2) cells of its path there, in its frame.
    """

    seen: Index
    path: Index
    size: float
    way: Array


class Bars(NamedTuple):
    """Doors in g: frames (n, 3), X along the line between the jambs, and widths (n,)."""

    frames: Array
    widths: Array

    def within(self, frame: Array, bounds: Array) -> list[Array]:
        """Those about a box, x and y (2, 2) in another frame, as segments (2, 2) there.

        They are a little wider than the doors are.
        """
        if not len(self.frames):
            return []
        there = se2.between(frame, self.frames)
        half = 0.5 * self.widths + BESIDE
        reach = half[:, None]
        near = ((there[:, :2] > bounds[0] - reach) & (there[:, :2] < bounds[1] + reach)).all(axis=1)
        return [_bar(there[i], float(half[i])) for i in np.flatnonzero(near).tolist()]


def _bar(door: Array, half: float) -> Array:
    ends = np.array([[-half, 0.0, 0.0], [half, 0.0, 0.0]])
    bar: Array = se2.compose(door, ends)[:, :2]
    return bar


def grounds(places: Places, frames: Array, bars: Bars, opening: float) -> list[Ground]:
    """The ground of every area within all doors, be they its own or not. frames: (A, 3) in g.

    A door parts the path of an area in which the robot went through it and did not notice. The
    larger part counts; but that in which the area began, at its frame's origin, if no other area
    has seen it.
    """
    found = [
        _ground(i, places.path(i), places, frame, bars, opening) for i, frame in enumerate(frames)
    ]
    out = list(found)
    for i, frame in enumerate(frames):
        path = places.path(i)
        if (len(path) - len(found[i].way)) * CELL < BEYOND:
            continue
        others = [one.seen for k, one in enumerate(found) if k != i]
        alone = path[~np.isin(_numbers(frame, path), np.concatenate(others or [_NONE]))]
        if len(alone) * CELL >= BEYOND:
            first = _ground(i, alone, places, frame, bars, opening)
            if np.hypot(*first.way.T).min(initial=np.inf) < BEGAN:
                out[i] = first
    return out


_NONE = np.zeros(0, dtype=np.int64)


def _ground(
    i: int, path: Array, places: Places, frame: Array, bars: Bars, opening: float
) -> Ground:
    """What of an area hangs together with most of a path (k, 2) in it."""
    if i not in places.grids:
        return Ground(_NONE, _NONE, 0.0, np.zeros((0, 2)))
    grid = places.grids[i]
    region = grid.region(path, bars.within(frame, grid.bounds()), opening)
    whole = places.path(i)
    way = whole[region.inside(whole)]
    return Ground(_squares(frame, region.centres()), _squares(frame, way), region.area(), way)


def _squares(frame: Array, points: Array) -> Index:
    """The squares of g, each once and in order, of points (n, 2) in an area's frame."""
    return np.unique(_numbers(frame, points))


def _numbers(frame: Array, points: Array) -> Index:
    """The number (n,) of the square of g in which each of the points (n, 2) of an area lies."""
    there = se2.compose(frame, np.column_stack((points, np.zeros(len(points)))))[:, :2]
    x, y = np.floor(there / SQUARE).astype(np.int64).T
    return np.asarray(x * _MANY + y)


def together(ground: Sequence[Ground]) -> float:
    """Square metres of the free space of several areas, what they share counted once."""
    every = sum(len(one.seen) for one in ground)
    if not every:
        return 0.0
    once = len(np.unique(np.concatenate([one.seen for one in ground])))
    return sum(one.size for one in ground) * once / every


class Open:
    """Whether two areas are parted by nothing as narrow as a door, by what both have seen.

    Who stands in the way hides from one of them what the other one sees.
    """

    def __init__(self, places: Places, frames: Array, bars: Bars, widest_door: float) -> None:
        self._places, self._frames = places, frames
        self._bars, self._widest_door = bars, widest_door

    def __call__(self, a: int, b: int) -> bool:
        """Whether most of either one's path lies in one piece of their free space together."""
        grids, R_a_b = self._places.grids, se2.between(self._frames[a], self._frames[b])
        grid = grids[a].joined(grids[b].moved(R_a_b))
        theirs = self._places.path(b)
        theirs = se2.compose(R_a_b, np.column_stack((theirs, np.zeros(len(theirs)))))[:, :2]
        ways = (self._places.path(a), theirs)
        bars = self._bars.within(self._frames[a], grid.bounds())
        region = grid.region(np.concatenate(ways), bars, self._widest_door)
        return all(2 * np.count_nonzero(region.inside(way)) > len(way) for way in ways)


def one_place(
    ground: Sequence[Ground],
    sure: Sequence[Ground],
    across: set[tuple[int, int]],
    share: float,
    is_open: Callable[[int, int], bool],
) -> list[tuple[int, int]]:
    """Pairs (a, b), a < b, of areas that have more than a share of their ground in common.

    That is of the smaller one's, or of the path in one of them. Two that lie side by side in a
    long place may have less, but `WAY` metres of either one's path.

    Args:
        ground: of every area, within the doors that are known.
        sure: of every area, within all openings as wide as a door.
        across: pairs (a, b), a < b, of which the robot drove from one into the other.
        share: of the ground.
        is_open: whether nothing as narrow as a door lies between two areas.
    """
    low, high = _bounds(ground)
    pairs: list[tuple[int, int]] = []
    for a, one in enumerate(ground):
        meet = (low[a] <= high).all(axis=1) & (low <= high[a]).all(axis=1)
        meet[: a + 1] = False
        for b in np.flatnonzero(meet).tolist():
            seen = (one, ground[b]) if (a, b) in across else (sure[a], sure[b])
            if (
                _alike(*seen) > share
                or _way_in_common(sure[a], sure[b]) > WAY
                or (_alike(one, ground[b]) > share and is_open(a, b))
            ):
                pairs.append((a, b))
    return pairs


def _way_in_common(a: Ground, b: Ground) -> float:
    """Metres of path in either area that lie in the other, the less of the two."""
    return SQUARE * min(_common(a.path, b.seen), _common(b.path, a.seen))


def _alike(a: Ground, b: Ground) -> float:
    """The larger of the shares."""
    return max(
        _common(a.seen, b.seen) / max(1, min(len(a.seen), len(b.seen))),
        _common(a.path, b.seen) / max(1, len(a.path)),
        _common(b.path, a.seen) / max(1, len(b.path)),
    )


def _common(a: Index, b: Index) -> int:
    return len(np.intersect1d(a, b, assume_unique=True))


def _bounds(ground: Sequence[Ground]) -> tuple[Index, Index]:
    """The least and greatest square (A, 2) of every area; of one without any they never meet."""
    low, high = np.full((len(ground), 2), _MANY), np.full((len(ground), 2), -_MANY)
    for i, one in enumerate(ground):
        if len(one.seen):
            x = (one.seen + _MANY // 2) // _MANY
            at = np.column_stack((x, one.seen - x * _MANY))
            low[i], high[i] = at.min(axis=0), at.max(axis=0)
    return low, high
