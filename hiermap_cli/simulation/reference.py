"""The reference map of a floor plan: the building as it is, and where the robot was in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.documents.reference import ReferenceArea, ReferenceDoor, ReferenceMap
from hiermap_cli.simulation.polygons import contains, crossings, within
from hiermap_cli.simulation.spec import OUTSIDE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.simulation.plan import Door, FloorPlan

    Array = NDArray[np.float64]

_LONGEST_STEP = 2.0  # metres between two scans; more is being carried, not driving
_CLEARLY = 0.05  # metres beyond a door's line that make a crossing


def reference_map(plan: FloorPlan, path: Array) -> ReferenceMap:
    """Walls and furniture as visible faces, doors at the middle of their walls, free areas.

    Args:
        plan: the building.
        path: (N, 2) the robot's true positions in order. An area that holds one of them was
            visited; a door was when the path crosses it from one side clearly to the other.

    An outer door leads to an area `outside:<door>` of its own, of kind "outside": a metre of
    the open air before it.
    """
    doors, areas = [], []
    for area in plan.areas:
        visited = bool(contains(area.inside, path).any())
        areas.append(ReferenceArea(area.id, area.kind, np.round(area.inside, 9), visited))
    for door in plan.doors:
        p1, p2 = np.round(door.p1, 9), np.round(door.p2, 9)
        doors.append(ReferenceDoor(door.id, door.areas, p1, p2, _crossed(door, path)))
        if door.porch is not None:
            name = next(name for name in door.areas if name.startswith(f"{OUTSIDE}:"))
            visited = bool(contains(door.porch, path).any())
            areas.append(ReferenceArea(name, OUTSIDE, np.round(door.porch, 9), visited))
    return ReferenceMap(plan.walls, plan.furniture, tuple(doors), tuple(areas))


def _crossed(door: Door, path: Array) -> bool:
    """Whether the path goes through the door from more than `_CLEARLY` on one side to the other."""
    line = np.concatenate((door.p1, door.p2))
    reach = float(np.hypot(*(door.p2 - door.p1))) + _LONGEST_STEP
    steps = np.hstack((path[:-1], path[1:]))
    near = within(
        steps, line.reshape(2, 2).min(axis=0) - reach, line.reshape(2, 2).max(axis=0) + reach
    )
    along = (door.p2 - door.p1) / np.hypot(*(door.p2 - door.p1))
    side = (path - door.p1) @ np.array([-along[1], along[0]])
    for index in np.flatnonzero(near):
        if np.hypot(*(path[index + 1] - path[index])) > _LONGEST_STEP:
            continue
        if not np.isfinite(crossings(steps[index : index + 1], line[None])).any():
            continue
        # How the path left the line on either side of the crossing.
        before = _departure(side[: index + 1][::-1])
        after = _departure(side[index + 1 :])
        if before * after < 0.0:
            return True
    return False


def _departure(sides: Array) -> float:
    """The first distance from the line that is clear, with its sign; 0 if there is none."""
    clear = np.flatnonzero(np.abs(sides) > _CLEARLY)
    return float(sides[clear[0]]) if len(clear) else 0.0
