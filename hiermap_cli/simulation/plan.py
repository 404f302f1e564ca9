"""From areas, doors and furniture to a floor plan: the free space and the faces that bound it.

A wall is what lies between the free insides of two areas, so every wall has the thickness that
the areas' outlines leave; a door is an opening through it with a jamb at either side. The faces
are the boundary of the free space, which is the union of all insides and openings (and of the
open air, where a door leads out of the building) less the free-standing walls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.faults import Fault
from hiermap_cli.simulation.faces import boundary
from hiermap_cli.simulation.polygons import (
    TINY,
    contains,
    counterclockwise,
    crossings,
    drawn_in,
    edges,
    is_simple,
    point_distances,
    signed_area,
)
from hiermap_cli.simulation.spec import OUTSIDE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.faults import KeyPath
    from hiermap_cli.simulation.spec import DoorSpec, Shape, WorldSpec

    Array = NDArray[np.float64]

DOOR_REACH = 0.05  # metres; a door may be given this far from its wall's middle line
PORCH_DEPTH = 1.0  # metres in front of an outer door that stand for the outside


@dataclass(frozen=True, slots=True)
class Area:
    """A room or corridor: `inside` (n, 2) is its free polygon, counterclockwise.

    `outer` (n, 2) is the same drawn out to the far faces of its walls, `middle` to their middle.
    """

    id: str
    kind: str
    inside: Array
    middle: Array
    outer: Array


@dataclass(frozen=True, slots=True)
class Door:
    """An opening between two areas; `p1`, `p2` (2,) on the wall's middle line, at the jambs.

    `opening` (4, 2) is the free space between both faces, counterclockwise or clockwise; its
    sides 1 -> 2 and 3 -> 0 are the jambs. `porch` (4, 2) is what stands for the outside in front
    of an outer door, None for the others.
    """

    id: str
    areas: tuple[str, str]
    p1: Array
    p2: Array
    opening: Array
    porch: Array | None


@dataclass(frozen=True, slots=True)
class FloorPlan:
    """A building: walls (W, 4) and furniture (F, 4) as faces with the free side on the left."""

    areas: tuple[Area, ...]
    doors: tuple[Door, ...]
    walls: Array
    furniture: Array

    def faces(self) -> Array:
        """Everything that the laser can see, (W + F, 4)."""
        return np.vstack((self.walls, self.furniture))

    def indoors(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (m, 2) lie in an area or in a door's opening."""
        found = np.zeros(len(points), dtype=bool)
        for polygon in (*(a.inside for a in self.areas), *(d.opening for d in self.doors)):
            found |= contains(polygon, points)
        return found

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (m, 2) lie indoors or in the porch of an outer door."""
        found = self.indoors(points)
        for door in self.doors:
            if door.porch is not None:
                found |= contains(door.porch, points)
        return found


def build_plan(spec: WorldSpec, faults: list[Fault]) -> FloorPlan | None:
    """The floor plan of a world; what is wrong is added to `faults`, and None comes out."""
    before = len(faults)
    areas = _areas(spec, faults)
    pillars = [
        counterclockwise(np.array(wall.corners()))
        for index, wall in enumerate(spec.walls)
        if _sound_shape(wall, ("walls", index), faults)
    ]
    doors = _doors(spec, areas, faults)
    furniture = _furniture(spec, areas, faults)
    if len(faults) > before:
        return None
    walls = boundary(
        insides=[area.inside for area in areas],
        openings=[door.opening for door in doors],
        # Nobody sees the outer walls but through a door to the outside.
        buildings=[area.outer for area in areas] if any(d.porch is not None for d in doors) else [],
        solids=pillars,
    )
    faces = [np.round(edges(corners[::-1]), 9) for corners in furniture]
    return FloorPlan(
        areas=tuple(areas),
        doors=tuple(doors),
        walls=walls,
        furniture=np.vstack(faces) if faces else np.zeros((0, 4)),
    )


def _sound_shape(shape: Shape, place: KeyPath, faults: list[Fault]) -> bool:
    corners = np.array(shape.corners())
    if is_simple(corners) and abs(signed_area(corners)) > TINY:
        return True
    faults.append(Fault(0, place, "its outline crosses or touches itself, or encloses nothing"))
    return False


def _areas(spec: WorldSpec, faults: list[Fault]) -> list[Area]:
    """All areas, drawn in by half their walls; faulty ones are left out."""
    areas: list[Area] = []
    places: list[int] = []  # of each in the file, where faulty ones stand too
    seen: set[str] = set()
    for index, entry in enumerate(spec.areas):
        place: KeyPath = ("areas", index)
        if entry.id in seen or entry.id == OUTSIDE:
            faults.append(
                Fault(0, (*place, "id"), f"'{entry.id}' is taken; give every area its own")
            )
        seen.add(entry.id)
        if not _sound_shape(entry, place, faults):
            continue
        half = 0.5 * (entry.wall_thickness or spec.wall_thickness)
        middle = counterclockwise(np.array(entry.corners()))
        inside, outer = drawn_in(middle, half), drawn_in(middle, -half)
        if signed_area(inside) <= TINY or not is_simple(inside) or _turned(middle, inside):
            faults.append(Fault(0, place, f"nothing is left inside walls of {2.0 * half:g} m"))
            continue
        areas.append(Area(entry.id, entry.kind, inside, middle, outer))
        places.append(index)
    low, high = _boxes(areas)
    for i, area in enumerate(areas):
        near = (low[:i] <= high[i]).all(axis=1) & (high[:i] >= low[i]).all(axis=1)
        faults.extend(
            Fault(0, ("areas", places[i]), f"'{areas[j].id}' and '{area.id}' overlap")
            for j in np.flatnonzero(near)
            if _overlap(area.inside, areas[j].inside)
        )
    return areas


def _boxes(areas: Sequence[Area]) -> tuple[Array, Array]:
    """Lowest and highest corner (n, 2) of each area's box."""
    low = np.array([area.inside.min(axis=0) for area in areas]).reshape(-1, 2)
    high = np.array([area.inside.max(axis=0) for area in areas]).reshape(-1, 2)
    return low, high


def _turned(before: Array, after: Array) -> bool:
    """Whether an edge has turned round because it was shorter than what was cut off it."""
    a, b = edges(before), edges(after)
    return bool((np.sum((a[:, 2:] - a[:, :2]) * (b[:, 2:] - b[:, :2]), axis=1) <= 0.0).any())


def _overlap(a: Array, b: Array) -> bool:
    if np.isfinite(crossings(edges(a), edges(b))).any():
        return True
    return bool(contains(a, b[:1])[0] or contains(b, a[:1])[0])


def _doors(spec: WorldSpec, areas: Sequence[Area], faults: list[Fault]) -> list[Door]:
    by_id = {area.id: area for area in areas}
    named = {area.id for area in spec.areas}
    doors = []
    seen: set[str] = set()
    for index, entry in enumerate(spec.doors):
        place: KeyPath = ("doors", index)
        if entry.id in seen:
            faults.append(
                Fault(0, (*place, "id"), f"'{entry.id}' is taken; give every door its own")
            )
        seen.add(entry.id)
        names = [name for name in entry.areas if name != OUTSIDE]
        unknown = [name for name in names if name not in named]
        faults.extend(Fault(0, (*place, "areas"), f"there is no area '{name}'") for name in unknown)
        if any(name not in by_id for name in names):
            continue  # an unknown area, or a faulty one that has been blamed itself
        if len(set(names)) != len(names) or not names:
            faults.append(Fault(0, (*place, "areas"), "a door joins two different areas"))
            continue
        door = _door(entry, place, [by_id[name] for name in names], areas, faults)
        if door is not None:
            doors.append(door)
    return doors


def _door(
    entry: DoorSpec,
    place: KeyPath,
    sides: Sequence[Area],
    areas: Sequence[Area],
    faults: list[Fault],
) -> Door | None:
    """The door in the edge that runs through `at` and belongs to each of `sides`."""
    at = np.array(entry.at)
    first = sides[0]
    found = _edge_at(first, at)
    if found is None:
        faults.append(Fault(0, (*place, "at"), f"no wall of '{first.id}' within {DOOR_REACH:g} m"))
        return None
    u, at = found.along, found.at
    outwards = np.array([u[1], -u[0]])
    spans, depths = [found.span], [found.depth]
    if len(sides) == 2:
        second = _edge_at(sides[1], at)
        if second is None or float(np.dot(second.along, u)) > -1.0 + 1e-6:
            faults.append(
                Fault(0, (*place, "at"), f"'{first.id}' and '{sides[1].id}' share no wall there")
            )
            return None
        spans.append((-second.span[1], -second.span[0]))
        depths.append(second.depth)
    else:
        depths.append(found.depth)
    half = 0.5 * entry.width
    room = min(min(-low, high) for low, high in spans)
    if half > room + TINY:
        faults.append(
            Fault(0, (*place, "width"), f"{entry.width:g} m is more than the wall has there")
        )
        return None
    p1, p2 = at - half * u, at + half * u
    near, far = -depths[0] * outwards, depths[1] * outwards
    opening = np.array([p1 + near, p2 + near, p2 + far, p1 + far])
    porch = None
    if len(sides) == 1:
        porch = np.array(
            [p1 + far, p2 + far, *(p + far + PORCH_DEPTH * outwards for p in (p2, p1))]
        )
        probes = 0.5 * (p1 + p2) + far + np.outer([1e-3, 0.5 * PORCH_DEPTH], outwards)
        if any(contains(area.outer, probes).any() for area in areas):
            faults.append(Fault(0, (*place, "areas"), f"there is no '{OUTSIDE}' behind that wall"))
            return None
    ids = (first.id, sides[1].id if len(sides) == 2 else f"{OUTSIDE}:{entry.id}")
    if entry.areas[0] != first.id:  # keep the order of the file
        ids = (ids[1], ids[0])
    return Door(entry.id, ids, p1, p2, opening, porch)


@dataclass(frozen=True, slots=True)
class _Edge:
    """A wall's middle line near a point: unit vector, the point on it, what is free about it.

    `span` is how far the area's inner face reaches to either side of the point along `along`;
    `depth` is the inner face's distance from the middle line.
    """

    along: Array
    at: Array
    span: tuple[float, float]
    depth: float


def _edge_at(area: Area, point: Array) -> _Edge | None:
    middle, inner = edges(area.middle), edges(area.inside)
    distances = point_distances(point[None], middle)[0]
    index = int(np.argmin(distances))
    if distances[index] > DOOR_REACH:
        return None
    start = middle[index, :2]
    along = middle[index, 2:] - start
    along = along / np.hypot(*along)
    at = start + np.dot(point - start, along) * along
    low, high = (float(np.dot(inner[index, k : k + 2] - at, along)) for k in (0, 2))
    depth = float(np.dot(inner[index, :2] - at, np.array([-along[1], along[0]])))
    return _Edge(along, at, (low, high), depth)


def _furniture(spec: WorldSpec, areas: Sequence[Area], faults: list[Fault]) -> list[Array]:
    """Outlines (n, 2) of the furniture, counterclockwise, each inside one area."""
    all_areas = len(areas) == len(spec.areas)  # else it may stand in one that is faulty
    out = []
    low, high = _boxes(areas)
    for index, entry in enumerate(spec.furniture):
        place: KeyPath = ("furniture", index)
        if not _sound_shape(entry, place, faults):
            continue
        corners = counterclockwise(np.array(entry.corners()))
        centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        c, s = np.cos(entry.turn), np.sin(entry.turn)
        corners = (corners - centre) @ np.array([[c, s], [-s, c]]) + centre
        slim = centre + (corners - centre) * (1.0 - 1e-4)  # what only touches a wall is inside
        boxed = (low <= slim.min(axis=0)).all(axis=1) & (high >= slim.max(axis=0)).all(axis=1)
        if all_areas and not any(_holds(areas[int(k)].inside, slim) for k in np.flatnonzero(boxed)):
            faults.append(Fault(0, place, "does not stand inside one area"))
            continue
        out.append(corners)
    return out


def _holds(area: Array, corners: Array) -> bool:
    """Whether a polygon lies wholly inside an area."""
    if not contains(area, corners).all():
        return False
    return not np.isfinite(crossings(edges(corners), edges(area))).any()
