"""People who walk about: straight ways at an even pace that never touch a wall.

Each walks to a point that it can reach in a straight line, then to another. Whoever comes too
near the robot steps back from it where there is room, and waits where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.simulation.polygons import point_distances, signed_area, way_clearance, within

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.simulation.plan import FloorPlan
    from hiermap_cli.simulation.spec import PeopleSpec

    Array = NDArray[np.float64]

STEP = 0.1  # seconds between the positions that are kept
_MARGIN = 0.05  # metres between a person and a wall
_COMFORT = 0.4  # metres between a person and the robot, skin to skin
_FARTHEST = 6.0  # metres of one straight way
_TRIES = 12  # ways thought of before standing for a moment
_PLACES = 2000  # tries to find a free place in the whole plan


@dataclass(frozen=True, slots=True)
class Walks:
    """Positions (T, K, 2) of K people every `STEP` seconds from the start."""

    positions: Array

    def at(self, seconds: Array) -> Array:
        """Positions (n, K, 2) at moments (n,), between the steps in a straight line."""
        steps = np.clip(np.asarray(seconds) / STEP, 0.0, len(self.positions) - 1)
        before = np.minimum(steps.astype(np.int64), max(len(self.positions) - 2, 0))
        after = np.minimum(before + 1, len(self.positions) - 1)
        share = (steps - before)[:, None, None]
        out: Array = (1.0 - share) * self.positions[before] + share * self.positions[after]
        return out


def walk(
    plan: FloorPlan, spec: PeopleSpec, robot: Array, robot_radius: float, rng: np.random.Generator
) -> Walks:
    """The walks of all people.

    Args:
        plan: the building.
        spec: how many, how fast, how wide.
        robot: (T, 2) the robot's position every `STEP` seconds.
        robot_radius: metres.
        rng: the only source of chance.
    """
    # Nobody leaves the building.
    exits = [np.concatenate((door.p1, door.p2)) for door in plan.doors if door.porch is not None]
    faces = np.vstack((plan.faces(), *exits))
    reach = spec.radius + _MARGIN
    keep_off = spec.radius + robot_radius + _COMFORT
    at = _places(plan, faces, spec, reach, rng)
    goals = at.copy()
    positions = np.empty((len(robot), len(at), 2))
    stride = spec.speed * STEP
    for k, here in enumerate(robot):
        to_goal = goals - at
        left = np.hypot(to_goal[:, 0], to_goal[:, 1])
        from_robot = at - here
        near = np.hypot(from_robot[:, 0], from_robot[:, 1])
        step = to_goal * np.minimum(stride / np.maximum(left, 1e-12), 1.0)[:, None]
        coming = np.hypot(*(from_robot + step).T)
        crowded = (coming < keep_off) & (coming < near)
        at = at + np.where(crowded[:, None], 0.0, step)
        for person in np.flatnonzero(near < keep_off):
            back = from_robot[person] * (stride / max(float(near[person]), 1e-12))
            if _is_free(at[person], at[person] + back, faces, reach):
                at[person] = goals[person] = at[person] + back
        for person in np.flatnonzero((left <= stride) | crowded):
            goals[person] = _goal(at[person], faces, reach, rng)
        positions[k] = at
    return Walks(positions)


def _places(
    plan: FloorPlan, faces: Array, spec: PeopleSpec, reach: float, rng: np.random.Generator
) -> Array:
    """Free places (K, 2) to begin at, by the areas' sizes; fewer where there is no room."""
    sizes = np.array([signed_area(area.inside) for area in plan.areas])
    places: list[Array] = []
    for _ in range(_PLACES):
        if len(places) == spec.number:
            break
        area = plan.areas[int(rng.choice(len(sizes), p=sizes / sizes.sum()))]
        low, high = area.inside.min(axis=0), area.inside.max(axis=0)
        point = low + (high - low) * rng.random(2)
        if plan.inside(point[None])[0] and _is_free(point, point, faces, reach):
            places.append(point)
    return np.array(places).reshape(-1, 2)


def _goal(here: Array, faces: Array, reach: float, rng: np.random.Generator) -> Array:
    """A point that can be walked to in a straight line; `here` where none was thought of."""
    angles = rng.uniform(-np.pi, np.pi, _TRIES)
    lengths = rng.uniform(0.5, _FARTHEST, _TRIES)
    goals = here + lengths[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    near = faces[within(faces, here - _FARTHEST - reach, here + _FARTHEST + reach)]
    ways = np.hstack((np.broadcast_to(here, goals.shape), goals))
    free = np.flatnonzero(way_clearance(ways, near) >= reach)
    goal: Array = goals[free[0]] if len(free) else here
    return goal


def _is_free(here: Array, there: Array, faces: Array, reach: float) -> bool:
    """Whether a disc of radius `reach` can go from `here` to `there` and touch no face."""
    low, high = np.minimum(here, there) - reach, np.maximum(here, there) + reach
    near = faces[within(faces, low, high)]
    if not len(near):
        return True
    if (here == there).all():
        return bool(point_distances(here[None], near).min() >= reach)
    return bool(way_clearance(np.concatenate((here, there))[None], near)[0] >= reach)
