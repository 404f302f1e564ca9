"""A robot that is carried elsewhere: noticed, mapped apart, and found again anywhere."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hiermap_cli.config import Config
from hiermap_cli.estimation.stochastic_map import initial_map
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import EMPTY, AreaMap, add_walls
from hiermap_cli.mapping.association.relocation import area_lines
from hiermap_cli.mapping.environment import Anchors, Link, compose_environment
from hiermap_cli.mapping.mapper import Mapper
from hiermap_cli.mapping.odometry.carried import CarryWatch
from hiermap_cli.mapping.run import map_log
from hiermap_cli.mapping.topology.lost import constellations, through_walls
from hiermap_cli.mapping.topology.passage import Passage
from hiermap_cli.mapping.topology.passages import PassageDetector
from hiermap_cli.mapping.topology.whereabouts import settled
from hiermap_cli.perception.views import SegmentView
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import build_world, load_world

DATASETS = Path(__file__).resolve().parents[1] / "datasets"
LIFTS = {
    "room": {"at": 51.5, "to": [3.95, 4.68, -2.63]},
    "ring": {"at": 49.0, "to": [3.9, 3.45, 0.39]},
}
CORRIDOR_LIFT = {"at": 78.0, "to": [8.6, 1.2, 3.1416]}  # from (11.6, 1.2), facing the other way


@cache
def carried(name, seed, *, lifted=True):
    """The result of a run in which the robot is lifted and put down 3 m away, and the truth."""
    spec = load_world(DATASETS / f"{name}.yaml").spec
    plain = spec.model_dump(exclude_none=True)
    if lifted:
        plain["lifts"] = [LIFTS[name]]
    simulation = simulate(
        build_world(type(spec).model_validate(plain)), np.random.default_rng(seed)
    )
    blocks = list(simulation.blocks())
    return simulation, map_log(iter(blocks), Config())


def errors(simulation, trajectory):
    """Metres that the robot is off at every scan, aligned at the first."""
    R_t_g = se2.compose(simulation.truth[0], se2.invert(trajectory.poses[0]))
    return np.hypot(*(se2.compose(R_t_g, trajectory.poses) - simulation.truth)[:, :2].T)


def seconds(simulation):
    return (simulation.stamps_ns - simulation.stamps_ns[0]) * 1e-9


@pytest.mark.parametrize("name", ["room", pytest.param("ring", marks=pytest.mark.slow)])
def test_a_carried_robot_is_found_and_spoils_nothing(name):
    simulation, result = carried(name, 0)
    off, t = errors(simulation, result.trajectory), seconds(simulation)
    at = LIFTS[name]["at"]
    assert off[t < at - 0.5].max() < 0.05  # the map from before is as it was
    assert off[t > at + 3.0].max() < 0.1  # and so is all that was mapped while it was lost
    kinds = [event.kind for event in result.events]
    assert kinds.count("lost") == 1
    lost = next(event for event in result.events if event.kind == "lost")
    start = simulation.stamps_ns[0] / 1e9
    assert lost.details["begin"] - start == pytest.approx(at, abs=1.0)
    assert at < lost.details["end"] - start < at + 20.0


def test_a_robot_that_is_lost_goes_through_no_door(monkeypatch):
    """What would begin an area there is taken back, and the area with it would hang on nothing."""
    spec = load_world(DATASETS / "room.yaml").spec
    plain = spec.model_dump(exclude_none=True) | {"lifts": [LIFTS["room"]]}
    simulation = simulate(build_world(type(spec).model_validate(plain)), np.random.default_rng(0))
    strays, passed, lost = Mapper._strays, PassageDetector.passed, [False]

    def watched(mapper, *args):
        strays(mapper, *args)
        lost.append(len(mapper._astray) >= mapper.config.lost.scans)

    def door(detector, trace):
        """A door wherever the robot is lost; otherwise what there is."""
        if lost[-1]:
            return Passage(trace.poses[-1], 0.9, trace.length, np.ones(2), np.zeros(2))
        return passed(detector, trace)

    # Not seen to be carried: it is by the walls that the robot must find out.
    monkeypatch.setattr(CarryWatch, "put_down", lambda *_: False)
    monkeypatch.setattr(Mapper, "_strays", watched)
    monkeypatch.setattr(PassageDetector, "passed", door)
    result = map_log(simulation.blocks(), Config())
    assert any(lost)
    assert len(result.model.areas) == 1
    assert not result.model.environment.doors


@pytest.mark.slow
def test_a_fragment_that_was_joined_is_no_area_of_its_own():
    _, plain = carried("room", 0, lifted=False)
    _, result = carried("room", 0)
    assert len(result.model.areas) == len(plain.model.areas) == 1
    walls = [sum(one.kind == "wall" for one in r.model.landmarks) for r in (plain, result)]
    assert walls[1] <= walls[0] + 4  # it was not mapped twice


def walled(walls):
    """An area map of walls given as (x1, y1, x2, y2), free side left, each seen often."""
    p = np.array(walls, dtype=float).reshape(-1, 2, 2)
    d = p[:, 1] - p[:, 0]
    n = len(p)
    view = SegmentView(
        p.mean(axis=1), np.arctan2(d[:, 1], d[:, 0]), np.full(n, 1e-6), np.full(n, 1e-6), p,
        np.zeros((n, 2), dtype=np.int64), np.full((n, 2), 0.01), np.hypot(*d.T),
    )  # fmt: skip
    V = initial_map(np.zeros(3), np.zeros((3, 3)), np.zeros(4), np.eye(4) * 1e-6)
    area = add_walls(AreaMap(V, EMPTY), view, np.arange(n), 0)
    features = area.features._replace(seen=np.full(n, 9))
    return AreaMap(area.V, features, area.next_uid), view


ROOM_WALLS = [(0, 0, 5, 0), (5, 0, 5, 3), (5, 3, 2, 3), (2, 3, 2, 4), (2, 4, 0, 4), (0, 4, 0, 0)]


def test_beams_through_walls_are_counted_and_those_that_end_at_them_are_not():
    area, _ = walled(ROOM_WALLS)
    origin = np.array([[1.0, 1.0]])
    ends = np.array([[4.9, 1.0], [5.2, 1.0], [5.6, 1.0], [1.0, -3.0], [3.0, 2.0], [4.0, 3.8]])
    assert through_walls(area, origin, ends, Config()) == pytest.approx(3 / 6)
    assert through_walls(area, origin, ends[:0], Config()) == 0.0
    unseen = AreaMap(area.V, area.features._replace(seen=np.ones(6, dtype=int)), area.next_uid)
    assert through_walls(unseen, origin, ends, Config()) == 0.0  # seen too seldom to be believed


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (3.0, -7.0, 2.5), (-20.0, 11.0, -1.2)])
def test_constellations_find_a_place_without_any_prior(pose):
    area, view = walled(ROOM_WALLS)
    R_a_v = np.array(pose)
    R_v_a = se2.invert(R_a_v)
    moved = se2.compose(R_v_a, np.column_stack((view.centre, view.theta)))
    c, s = np.cos(R_v_a[2]), np.sin(R_v_a[2])
    ends = R_v_a[:2] + view.ends @ np.array([[c, s], [-s, c]])
    seen = view._replace(centre=moved[:, :2], theta=moved[:, 2], ends=ends)
    found = constellations(area_lines(area, 3), seen)
    off = se2.between(R_a_v, found)
    assert (np.hypot(off[:, 0], off[:, 1]) + np.abs(off[:, 2])).min() < 1e-6


def test_a_pose_is_brought_to_where_its_walls_lie_on_the_lines():
    area, view = walled(ROOM_WALLS)
    off = np.array([[0.06, -0.04, 0.02], [-0.05, 0.05, -0.03]])
    found = settled(area_lines(area, 3), view, off, Config().relocation)
    np.testing.assert_allclose(found, np.zeros((2, 3)), atol=2e-3)


@pytest.mark.slow
def test_a_robot_put_down_in_a_corridor_is_found_before_it_maps_it_twice():
    """From anywhere in the corridor the same two walls are seen, and the doors tell where."""
    spec = load_world(DATASETS / "office.yaml").spec
    plain = spec.model_dump(exclude_none=True)
    plain["way_points"] = plain["way_points"][:17]
    plain["lifts"] = [CORRIDOR_LIFT]
    simulation = simulate(build_world(type(spec).model_validate(plain)), np.random.default_rng(0))
    result = map_log(simulation.blocks(), Config())
    off, t = errors(simulation, result.trajectory), seconds(simulation)
    assert [event.kind for event in result.events].count("lost") == 1
    assert off[t < CORRIDOR_LIFT["at"] - 0.5].max() < 0.05
    assert off[-1] < 0.1


def test_a_fragment_may_be_joined_by_an_area_that_was_discovered_from_it():
    """0 is the map; 1 was begun lost, 2 was entered from 1 by a door, and 2 lies in 0."""
    step, P = np.array([2.0, 0.0, 0.5]), np.zeros((6, 6))
    areas = [Anchors(np.array([np.zeros(3), step]), P) for _ in range(3)]
    links = [Link(0, 1, 2, 1), Link(1, 1, 2, 0)]
    environment = compose_environment(areas, links, np.zeros(3), np.zeros((3, 3)))
    np.testing.assert_allclose(environment.frames[2], np.zeros(3), atol=1e-12)
    np.testing.assert_allclose(
        se2.compose(environment.frames[1], step), environment.frames[2], atol=1e-12
    )
