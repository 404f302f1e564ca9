"""The free space of every area while the log is read: which area each scan belongs to."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.portals import door_frame
from hiermap_cli.mapping.topology.freespace import CELL, FreeGrid, Region
from hiermap_cli.mapping.topology.whereabouts import Seen, seen

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.portals import Portal
    from hiermap_cli.mapping.topology.looks import LookRecord
    from hiermap_cli.mapping.topology.trace import Trace

    Array = NDArray[np.float64]

APART, APART_ANGLE = 0.3, 0.4  # metres or radians between scans that are looked at
BESIDE = 0.5  # metres beyond a door's jambs that are barred too
NEAR_BY = 4.0  # metres from where it was in an area within which it may know the place again
AT_HOME = 1.5  # metres from where it was within which it is there again
GROUND = 1.0  # metres: cells by which it is told where the robot was


@cache
def _disc(radius: int) -> tuple[tuple[int, int], ...]:
    """Cells within a radius of one."""
    steps = range(-radius, radius + 1)
    return tuple((i, j) for i in steps for j in steps if i * i + j * j <= radius * radius)


class Ground:
    """Where the robot has been in an area, told by cells of `GROUND`."""

    def __init__(self) -> None:
        self._been: set[tuple[int, int]] = set()
        # Of each radius the cells that near, and the metres of path at which it first came so.
        self._near: dict[float, dict[tuple[int, int], float]] = {AT_HOME: {}, NEAR_BY: {}}

    def visit(self, x: float, y: float, travelled: float) -> None:
        """The robot is there at `travelled` metres of path; never fewer than before."""
        cell = (math.floor(x / GROUND), math.floor(y / GROUND))
        if cell in self._been:
            return
        self._been.add(cell)
        for radius, first in self._near.items():
            for i, j in _disc(round(radius / GROUND)):
                first.setdefault((cell[0] + i, cell[1] + j), travelled)

    def since(self, x: float, y: float, radius: float) -> float:
        """Metres of path at which it first was within `AT_HOME` or `NEAR_BY` metres of a point."""
        return self._near[radius].get((math.floor(x / GROUND), math.floor(y / GROUND)), math.inf)


@dataclass(slots=True)
class Places:
    """A grid of free space and the cells of the robot's path for each area.

    A scan is looked at when the path has gone on so far that any door between is known: so what
    the robot saw after a door is the next area's, although it learned of the door later.
    """

    widest_door: float  # metres
    looks: LookRecord | None = None  # all that is taken is kept there too
    grids: dict[int, FreeGrid] = field(default_factory=dict)
    paths: dict[int, set[tuple[int, int]]] = field(default_factory=dict)
    ground: dict[int, Ground] = field(default_factory=dict)
    _last: tuple[float, float] = (-np.inf, 0.0)
    _area: int = -1
    _regions: dict[int, tuple[int, int, Region]] = field(default_factory=dict)
    _seen: dict[int, tuple[int, Seen]] = field(default_factory=dict)

    def look(self, area: int, trace: Trace, behind: float) -> None:
        """Scans taken more than `behind` metres of path ago belong to this area."""
        for i in trace.older(behind):
            self._take(area, trace, i)

    def leave(self, area: int, trace: Trace, door: Array, sign: float = 1.0) -> None:
        """The robot has gone out by a door (3,), in the direction of `sign` times its Y.

        Scans taken before it belong to this area, those after it to the next one.
        """
        first = len(trace.poses) - trace.fresh
        beyond = [
            sign * se2.between(door, trace.poses[i])[1] > 0.0
            for i in range(first, len(trace.poses))
        ]
        before = len(beyond)
        while before and beyond[before - 1]:
            before -= 1
        for i in range(first, first + before):
            self._take(area, trace, i)
        trace.fresh -= before

    def rewind(self, key: int) -> None:
        """Key scans from this one on were not seen from where the robot was believed to be."""
        if self.looks is not None:
            self.looks.rewind(key)

    def _take(self, area: int, trace: Trace, i: int) -> None:
        pose, at = trace.poses[i], trace.travelled[i]
        path = self.paths.setdefault(area, set())
        before = trace.poses[i - 1] if i and self._area == area else pose
        self._area = area
        (x, y), (x0, y0) = pose[:2].tolist(), before[:2].tolist()
        steps = 1 + int(math.hypot(x - x0, y - y0) / (0.5 * CELL))
        for k in range(steps + 1):
            f = k / steps
            way = x0 + f * (x - x0), y0 + f * (y - y0)
            path.add((math.floor(way[0] / CELL), math.floor(way[1] / CELL)))
        if area not in self.ground:
            self.ground[area] = Ground()
        self.ground[area].visit(x, y, at)
        turned = trace.turned[i]
        near = at - self._last[0] < APART and abs(turned - self._last[1]) < APART_ANGLE
        if self.looks is not None:
            self.looks.add(trace.keys[i], area, None if near else trace.sights[i])
        if near:
            return
        self._last = (at, turned)
        grid = self.grids.setdefault(area, FreeGrid())
        grid.add(trace.origins[i], trace.ends[i])

    def known_ground(self, area: int, point: Array, before: float, radius: float) -> bool:
        """Whether the robot was near a point of the area, long enough ago.

        before: metres of path at which it was there at the latest. radius: `AT_HOME` or `NEAR_BY`.
        """
        ground = self.ground.get(area)
        return ground is not None and ground.since(point[0], point[1], radius) < before

    def region(self, area: int, map_: AreaMap, portals: Sequence[Portal]) -> Region:
        """The free space of an area within its doors, in its frame, where it surely is the area.

        What is seen through any opening that may be a door is left out.
        """
        grid = self.grids.get(area)
        if grid is None:
            return Region(np.zeros((0, 0), dtype=bool), (0, 0))
        doors = sum((p.a == area) + (p.b == area) for p in portals if p.kind == "door")
        known = self._regions.get(area)
        if known is not None:
            scans, barriers, region = known
            # A tenth more scans hardly move its bounds.
            if barriers == doors and scans <= grid.scans <= 1.1 * scans + 2.0:
                return region
        bars = door_barriers(area, map_, portals)
        region = grid.region(self.path(area), bars, self.widest_door, NEAR_BY)
        self._regions[area] = (grid.scans, doors, region)
        return region

    def seen(self, area: int) -> Seen:
        """What was seen of an area, for one that may be the same."""
        grid = self.grids.get(area, FreeGrid())
        known = self._seen.get(area)
        if known is None or known[0] != grid.scans:
            known = self._seen[area] = (grid.scans, seen(grid))
        return known[1]

    def path(self, area: int) -> Array:
        """Where the robot was in an area: cells' centres (n, 2), in its frame."""
        return CELL * (np.array(sorted(self.paths.get(area, ()))).reshape(-1, 2) + 0.5)

    def size(self, area: int, map_: AreaMap, portals: Sequence[Portal], opening: float) -> float:
        """Square metres of an area's free space as far as it is wider than `opening` metres."""
        grid = self.grids.get(area, FreeGrid())
        doors = door_barriers(area, map_, portals)
        return grid.region(self.path(area), doors, opening).area()

    def within(self, trace: Trace, R_h_c: Array, region: Region, since: float) -> bool:
        """Whether all the path since `since` lies in a region of another area."""
        first = int(np.searchsorted(trace.travelled, since))
        if since < trace.travelled[0]:
            return False
        poses = se2.compose(R_h_c, np.array(trace.poses[first:]))
        inside = sum(region.contains(pose[:2]) for pose in poses)
        return inside >= 0.8 * len(poses)


def door_barriers(area: int, map_: AreaMap, portals: Sequence[Portal]) -> list[Array]:
    """The doors of an area as segments (2, 2) in its frame, a little wider than they are."""
    out = []
    for p in portals:
        for side in (True, False):
            if p.kind == "door" and (p.a if side else p.b) == area:
                half = 0.5 * p.width + BESIDE
                R = door_frame(map_, p, from_a=side)
                ends = np.array([[-half, 0.0, 0.0], [half, 0.0, 0.0]])
                out.append(se2.compose(R, ends)[:, :2])
    return out
