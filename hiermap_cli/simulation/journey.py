"""The whole journey of a robot: its legs, and what it must not touch on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.faults import Fault
from hiermap_cli.geometry.se2 import between, compose
from hiermap_cli.simulation.motion import Leg, drive
from hiermap_cli.simulation.polygons import point_distances, within

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hiermap_cli.faults import KeyPath
    from hiermap_cli.simulation.plan import FloorPlan
    from hiermap_cli.simulation.spec import WorldSpec

    Array = NDArray[np.float64]

_CHECK_EVERY = 4  # knots, some centimetres of the way
_CHUNK = 256  # points checked at once against the faces near them


@dataclass(frozen=True, slots=True)
class Journey:
    """Legs in order of time; `arrivals` (n, 2) seconds each way point is reached and left."""

    legs: tuple[Leg, ...]
    arrivals: Array

    @property
    def end(self) -> float:
        """Seconds from the start to the end."""
        return self.legs[-1].end

    def poses(self, seconds: Array) -> Array:
        """True poses (n, 3) of the robot in the world frame."""
        out = self.legs[0].poses(seconds)
        for leg in self.legs[1:]:
            later = seconds >= leg.begin
            out[later] = leg.poses(seconds[later])
        return out

    def increments(self, seconds: Array) -> Array:
        """What the wheels turn between successive moments (n,): poses (n - 1, 3).

        Being carried turns no wheel: only the motion within the legs counts.
        """
        total = np.zeros((len(seconds) - 1, 3))
        for leg in self.legs:
            poses = leg.poses(np.clip(seconds, leg.begin, leg.end))
            total = compose(total, between(poses[:-1], poses[1:]))
        return total


def plan_journey(spec: WorldSpec, faults: list[Fault]) -> Journey | None:
    """The journey through the way points of a world, lifts included; None where it has faults."""
    start = np.array([*spec.way_points[0].at, _start_heading(spec)])
    legs = [drive(start, spec.way_points, spec.robot)]
    reached: list[Array] = []
    ahead = list(spec.way_points)
    before = len(faults)
    for index, lift in sorted(enumerate(spec.lifts), key=lambda item: item[1].at):
        leg = legs[-1]
        if not leg.begin < lift.at < leg.end:
            message = f"the robot drives from {leg.begin:.1f} s to {leg.end:.1f} s"
            faults.append(Fault(0, ("lifts", index, "at"), message))
            continue
        done = int(np.count_nonzero(leg.arrivals[:, 0] <= lift.at))
        reached.append(np.minimum(leg.arrivals[:done], lift.at))
        ahead = ahead[done:]
        legs[-1] = _cut(leg, lift.at, 0.5 * lift.pause)
        legs.append(
            drive(np.array(lift.to), ahead, spec.robot, legs[-1].end, stand=0.5 * lift.pause)
        )
    for index, bend in enumerate(spec.odometry.bends):
        if bend.after + 1 >= len(spec.way_points):
            place: KeyPath = ("odometry", "bends", index, "after")
            faults.append(Fault(0, place, f"no way point follows {bend.after}"))
    if len(faults) > before:
        return None
    return Journey(tuple(legs), np.vstack([*reached, legs[-1].arrivals]))


def _start_heading(spec: WorldSpec) -> float:
    if spec.robot.heading is not None:
        return spec.robot.heading
    x, y = spec.way_points[0].at
    for point in spec.way_points[1:]:
        if point.at != (x, y):
            return math.atan2(point.at[1] - y, point.at[0] - x)
    return 0.0


def _cut(leg: Leg, at: float, stand: float) -> Leg:
    """The leg up to `at`, and `stand` seconds where it is then."""
    kept = leg.knots_t < at
    s = float(leg.way(np.array([at]))[0])
    run_out = float(leg.knots_s[kept][-1]), float(leg.knots_t[kept][-1])
    speed = max(2.0 * (s - run_out[0]) / (at - run_out[1]) - float(leg.knots_v[kept][-1]), 0.0)
    return replace(
        leg,
        knots_t=np.array([*leg.knots_t[kept], at, at, at + stand]),
        knots_s=np.array([*leg.knots_s[kept], s, s, s]),
        knots_v=np.array([*leg.knots_v[kept], speed, 0.0, 0.0]),
    )


def check_journey(spec: WorldSpec, plan: FloorPlan, journey: Journey, faults: list[Fault]) -> None:
    """Adds a fault for each way point or lift outside, and each way with a collision on it."""
    places: dict[KeyPath, tuple[float, float]] = {
        ("way_points", k, "at"): point.at for k, point in enumerate(spec.way_points)
    }
    places |= {("lifts", k, "to"): lift.to[:2] for k, lift in enumerate(spec.lifts)}
    inside = plan.inside(np.array(list(places.values())))
    faults.extend(
        Fault(0, place, "lies in no area and in no door")
        for place, is_inside in zip(places, inside, strict=True)
        if not is_inside
    )
    blamed: set[int] = set()
    for seconds, points, clearance in _clearances(plan, journey):
        for k in np.flatnonzero(clearance < spec.robot.radius):
            target = int(np.searchsorted(journey.arrivals[:, 0], seconds[k]))
            if target not in blamed:
                x, y = points[k]
                message = (
                    f"on the way there the robot (radius {spec.robot.radius:g} m) comes within "
                    f"{clearance[k]:.2f} m of something at ({x:.2f}, {y:.2f})"
                )
                place = ("way_points", min(target, len(spec.way_points) - 1))
                faults.append(Fault(0, place, message))
            blamed.add(target)


def _clearances(plan: FloorPlan, journey: Journey) -> Iterator[tuple[Array, Array, Array]]:
    """Moments (k,), positions (k, 2) and distances (k,) from the nearest face, in runs."""
    faces = plan.faces()
    reach = 1.0  # metres; what is farther is never too near
    for leg in journey.legs:
        moments = np.append(leg.knots_t[::_CHECK_EVERY], leg.end)
        for first in range(0, len(moments), _CHUNK):
            seconds = moments[first : first + _CHUNK]
            points = leg.poses(seconds)[:, :2]
            near = within(faces, points.min(axis=0) - reach, points.max(axis=0) + reach)
            if near.any():
                yield seconds, points, point_distances(points, faces[near]).min(axis=1)
