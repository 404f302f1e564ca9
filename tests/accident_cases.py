"""Worlds in which people walk about, the robot is carried or its odometry lies, and what came."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.config import Config
from hiermap_cli.errors import ConfigurationError
from hiermap_cli.evaluation.areas import area_metrics, topology_metrics
from hiermap_cli.evaluation.doors import door_metrics
from hiermap_cli.evaluation.placed import place
from hiermap_cli.evaluation.trajectory import ate
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.run import map_log
from hiermap_cli.simulation.reference import OUTSIDE
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import build_world

if TYPE_CHECKING:
    from hiermap_cli.mapping.model import MapResult
    from hiermap_cli.simulation.simulator import Simulation
    from hiermap_cli.simulation.spec import WorldSpec
    from hiermap_cli.simulation.world import World

# How the wheels lie: what they miss between two way points, or for some seconds.
BENDS = {"bend": [0.4, 0.0, 0.0873], "jump": [1.2, 0.3, 0.5]}
FAULTS = {"reversed": 8.0, "missing": 3.0}
BEHIND = 4  # the way point behind which they miss it: in the room that between stops 5 and 6
LATE = 0.6  # of the journey, when a fault begins
SCENARIOS = ("plain", "people", "lifted", *BENDS, *FAULTS)
NOTICED = (
    "odometry_reversed", "odometry_missing", "odometry_failed", "relocated", "lost",
)  # fmt: skip
BARS = {"room": 0.05, "room_corridor": 0.05, "ring": 0.05, "office": 0.10}  # metres at the end
PEOPLE = 10
FAR = (2.5, 3.5)  # metres that a lifted robot is put down away
WHILE = (0.3, 0.9)  # of the journey in which it is lifted
FROM_DOOR = 1.0  # metres from a doorway to where it is lifted: it was clearly through, or not
NO_POSES = np.zeros((0, 3))


class Outcome(NamedTuple):
    """What came of a run.

    end: metres that the robot is off at the end, aligned at the first pose. wrong: what is wrong
    with the areas and doors that the robot truly was in and drove through, if anything. noticed:
    the kinds of accidents that the run tells of.
    """

    end: float
    wrong: str
    noticed: frozenset[str]

    def success(self, bar: float) -> bool:
        """Whether the map is right and the robot where it is."""
        return not self.wrong and self.end < bar


def spoilt(spec: WorldSpec, scenario: str, seed: int) -> World:
    """The world of a scenario; where the robot is lifted depends on the seed."""
    if scenario == "plain":
        return build_world(spec)
    if scenario == "lifted":
        return lifted(spec, np.random.default_rng([seed, 1]))
    changed = spec.model_dump(exclude_none=True)
    if scenario == "people":
        changed["people"] = {"number": PEOPLE}
    elif scenario in BENDS:
        changed["odometry"]["bends"] = [{"after": BEHIND, "bend": BENDS[scenario]}]
    else:
        begin = LATE * build_world(spec).journey.end
        fault = {"kind": scenario, "begin": begin, "end": begin + FAULTS[scenario]}
        changed["odometry"]["faults"] = [fault]
    return build_world(type(spec).model_validate(changed))


def lifted(spec: WorldSpec, rng: np.random.Generator) -> World:
    """The robot is lifted anywhere on its way and put down some 3 m away.

    That is where it has been before, facing as it did then, be it in another room.
    """
    plain = spec.model_dump(exclude_none=True)
    journey = build_world(spec).journey
    times = np.arange(0.0, journey.end, 0.5)
    poses = journey.poses(times)
    doors = np.array([door.at for door in spec.doors]).reshape(-1, 2)
    first, last = (int(share * len(times)) for share in WHILE)
    for k in rng.permutation(np.arange(first, last)).tolist():
        if (np.hypot(*(doors - poses[k, :2]).T) < FROM_DOOR).any():
            continue
        far = np.hypot(*(poses[:k, :2] - poses[k, :2]).T)
        for i in rng.permutation(np.flatnonzero((far > FAR[0]) & (far < FAR[1])))[:5].tolist():
            lift = {"at": float(times[k]), "to": poses[i].tolist()}
            try:
                return build_world(type(spec).model_validate({**plain, "lifts": [lift]}))
            except ConfigurationError:  # from there it would drive through something
                continue
    raise AssertionError("nowhere to put the robot down")


def outcome(spec: WorldSpec, scenario: str, seed: int) -> Outcome:
    """One run."""
    simulation = simulate(spoilt(spec, scenario, seed), np.random.default_rng(seed))
    return judged(simulation, map_log(simulation.blocks(), Config()))


def judged(simulation: Simulation, result: MapResult) -> Outcome:
    """What came of a run."""
    track = result.trajectory
    R_t_g = se2.compose(simulation.truth[0], se2.invert(track.poses[0]))
    error = se2.compose(R_t_g, track.poses[-1]) - simulation.truth[-1]
    reference = simulation.reference_map
    indoors = tuple(area for area in reference.areas if area.kind != OUTSIDE)
    reference = replace(reference, areas=indoors)
    fit = ate(track.stamps_ns, track.poses, simulation.stamps_ns, simulation.truth)
    placed = place(result.model, fit.alignment)
    areas = area_metrics(placed, reference, NO_POSES)
    doors = door_metrics(placed, reference)
    edges = topology_metrics(placed, reference)
    wrong = []
    if not areas.found == areas.asked == len(areas.matches):
        wrong.append(f"{len(areas.matches)} of {areas.asked} areas, {areas.found} in the model")
    if doors.missed or doors.false:
        wrong.append(f"doors missed {list(doors.missed)}, {len(doors.false)} false")
    if edges.missed or edges.false:
        wrong.append(f"edges missed {list(edges.missed)}, {len(edges.false)} false")
    told = frozenset(event.kind for event in result.events) & frozenset(NOTICED)
    return Outcome(float(np.hypot(error[0], error[1])), "; ".join(wrong), told)
