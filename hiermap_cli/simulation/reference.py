"""The reference map of a floor plan: the building as it is, and where the robot was in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.documents.reference import ReferenceArea, ReferenceDoor, ReferenceMap
from hiermap_cli.simulation.polygons import contains, crossings
from hiermap_cli.simulation.spec import OUTSIDE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.simulation.plan import Door, FloorPlan

    Array = NDArray[np.float64]

_RUN = 256  # positions in a run
_NEAR_DOOR = 3.0  # metres about a door within which a crossing begins and ends
_LONGEST_STEP = 1.5  # metres between two scans; more is being carried, not driving
_BESIDE = 1e-5  # metres from a face to the point that tells what lies before it
_CLEARLY = 0.05  # metres beyond a door's line that make a crossing


def reference_map(plan: FloorPlan, path: Array) -> ReferenceMap:
    """Walls and furniture as visible faces, doors at the middle of their walls, free areas.

    Args:
        plan: the building.
        path: (N, 2) the robot's true positions in order. An area that holds one of them was
            visited; a door was when the path crosses it from one side clearly to the other.

    Outer walls are there only if the robot was outside: from indoors nobody sees them.

    An outer door leads to an area `outside:<door>` of its own, of kind "outside": a metre of
    the open air before it.
    """
    places = _Path(path)
    doors, areas = [], []
    for area in plan.areas:
        visited = places.enters(area.inside)
        areas.append(ReferenceArea(area.id, area.kind, np.round(area.inside, 9), visited))
    for door in plan.doors:
        p1, p2 = np.round(door.p1, 9), np.round(door.p2, 9)
        doors.append(ReferenceDoor(door.id, door.areas, p1, p2, _crossed(door, places)))
        if door.porch is not None:
            name = next(name for name in door.areas if name.startswith(f"{OUTSIDE}:"))
            visited = places.enters(door.porch)
            areas.append(ReferenceArea(name, OUTSIDE, np.round(door.porch, 9), visited))
    walls = _inner_walls(plan) if _indoors(plan, places) else plan.walls
    return ReferenceMap(walls, plan.furniture, tuple(doors), tuple(areas))


def _inner_walls(plan: FloorPlan) -> Array:
    """The walls (W, 4) whose free side is indoors."""
    along = plan.walls[:, 2:] - plan.walls[:, :2]
    left = np.column_stack((-along[:, 1], along[:, 0]))
    left *= _BESIDE / np.hypot(along[:, 0], along[:, 1])[:, None]
    inner: Array = plan.walls[plan.indoors(0.5 * (plan.walls[:, :2] + plan.walls[:, 2:]) + left)]
    return inner


def _indoors(plan: FloorPlan, path: _Path) -> bool:
    """Whether every position lies in an area or in a door's opening."""
    outside = np.ones(len(path.points), dtype=bool)
    for polygon in (*(a.inside for a in plan.areas), *(d.opening for d in plan.doors)):
        index = path.near(polygon)
        outside[index[contains(polygon, path.points[index])]] = False
    return not outside.any()


class _Path:
    """Positions (N, 2) in order, in runs with a box each, so that what is far off costs nothing."""

    def __init__(self, points: Array) -> None:
        self.points = points
        starts = np.arange(0, len(points), _RUN)
        self._low = np.minimum.reduceat(points, starts)
        self._high = np.maximum.reduceat(points, starts)

    def near(self, corners: Array, reach: float = 0.0) -> NDArray[np.int64]:
        """Indices of the positions within `reach` of the box about `corners` (m, 2), in order."""
        low, high = corners.min(axis=0) - reach, corners.max(axis=0) + reach
        runs = np.flatnonzero(((self._low <= high) & (self._high >= low)).all(axis=1))
        index = (runs[:, None] * _RUN + np.arange(_RUN)).ravel()
        index = index[index < len(self.points)]
        points = self.points[index]
        found: NDArray[np.int64] = index[((points >= low) & (points <= high)).all(axis=1)]
        return found

    def enters(self, polygon: Array) -> bool:
        """Whether a position lies inside."""
        return bool(contains(polygon, self.points[self.near(polygon)]).any())


def _crossed(door: Door, path: _Path) -> bool:
    """Whether the path goes through the door from more than `_CLEARLY` on one side to the other."""
    width = float(np.hypot(*(door.p2 - door.p1)))
    across = np.array([door.p1[1] - door.p2[1], door.p2[0] - door.p1[0]]) / width
    line = np.concatenate((door.p1, door.p2))[None]
    index = path.near(np.array([door.p1, door.p2]), reach=_NEAR_DOOR)
    for visit in np.split(index, np.flatnonzero(np.diff(index) > 1) + 1):
        points = path.points[visit]
        side = (points - door.p1) @ across
        clear = np.flatnonzero(np.abs(side) > _CLEARLY)
        for k in np.flatnonzero(side[clear[:-1]] * side[clear[1:]] < 0.0):
            i, j = int(clear[k]), int(clear[k + 1])
            steps = np.hstack((points[i:j], points[i + 1 : j + 1]))
            driven = np.hypot(*(steps[:, 2:] - steps[:, :2]).T).max() < _LONGEST_STEP
            if driven and np.isfinite(crossings(steps, line)).any():
                return True
    return False
