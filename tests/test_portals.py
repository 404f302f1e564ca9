"""Portals: known doors watched, areas' frames seen from each other, decisions about doors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hiermap_cli.config import AreaConfig, DoorConfig
from hiermap_cli.estimation.stochastic_map import Motion, initial_map, predict
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import EMPTY, AreaMap
from hiermap_cli.mapping.areas.rooms import decide
from hiermap_cli.mapping.association.recognition import Ways, relative_frames
from hiermap_cli.mapping.portals import KnownDoors, Portal, add_anchor, anchor_index, door_frame
from hiermap_cli.mapping.topology.freespace import FreeGrid
from hiermap_cli.mapping.topology.places import Places

STEP = np.array([4.0, 0.0, 0.0])
NOISE = np.diag([1e-4, 4e-4, 1e-4])
ACROSS = np.array([0.0, 0.0, -0.5 * np.pi])  # a door where the robot is, crossed along its X


def fresh():
    return AreaMap(initial_map(np.zeros(3), np.zeros((3, 3)), np.zeros(0), np.zeros((0, 0))), EMPTY)


def driven(area, step=STEP):
    return AreaMap(
        predict(area.V, Motion(step, NOISE, np.zeros((3, 0)))), area.features, area.next_uid
    )


def chain(areas, width=0.9, wall=2.0, **changes):
    """Areas one behind the other, 4 m long, with a door between each and the next."""
    maps, portals = [], []
    area, entered = add_anchor(fresh(), 0)
    for i in range(areas):
        area, out = add_anchor(driven(area), 1)
        maps.append(area)
        area, into = add_anchor(fresh(), 1)
        if i + 1 < areas:
            portals.append(Portal(i, out, i + 1, into, "door", ACROSS, width, wall, 0.0, **changes))
    assert entered == 0
    return maps, portals


def strip(length=4.0, width=3.0):
    """A grid of free space along the X axis."""
    n, m = round(length / 0.1), round(width / 0.1)
    return FreeGrid(np.ones((n, m), np.uint8), np.zeros((n, m), np.uint8), (0, -m // 2), scans=1)


def places_of(sizes):
    places = Places(DoorConfig().max_width)
    for i, length in enumerate(sizes):
        places.grids[i] = strip(length)
        places.paths[i] = {(k, 0) for k in range(round(length / 0.1))}
    return places


def decided(maps, portals, sizes=None):
    frames = np.array([[4.0 * i, 0.0, 0.0] for i in range(len(maps))])
    sizes = [4.0] * len(maps) if sizes is None else sizes
    return decide(maps, portals, places_of(sizes), frames, DoorConfig(), AreaConfig())


def watched(maps, portals, area, hysteresis=0.4):
    doors = KnownDoors(hysteresis)
    doors.set(area, maps, portals)
    return doors


def test_a_door_lies_in_both_areas_at_one_place():
    maps, portals = chain(2)
    assert door_frame(maps[0], portals[0], from_a=True) == pytest.approx([4.0, 0.0, -0.5 * np.pi])
    assert door_frame(maps[1], portals[0], from_a=False) == pytest.approx([0.0, 0.0, -0.5 * np.pi])


def test_an_anchor_is_the_robot_and_stays():
    area, uid = add_anchor(driven(fresh()), 3)
    i = anchor_index(area, uid)
    assert area.V.poses[i] == pytest.approx(STEP)
    assert area.V.pose_covariance(i) == pytest.approx(area.V.pose_covariance(0))


def test_the_robot_has_left_when_it_is_well_beyond_the_door():
    maps, portals = chain(2)
    doors = watched(maps, portals, 0)
    told = [doors.gone_through(np.array([x, 0.1, 0.0])) for x in np.arange(3.0, 4.8, 0.1)]
    assert [t for t in told if t is not None] == [0] * sum(t is not None for t in told)
    first = next(i for i, t in enumerate(told) if t is not None)
    assert np.arange(3.0, 4.8, 0.1)[first] == pytest.approx(4.5, abs=0.11)


def test_the_way_back_counts_too():
    maps, portals = chain(2)
    doors = watched(maps, portals, 1)
    told = [doors.gone_through(np.array([x, 0.0, np.pi])) for x in np.arange(1.0, -0.8, -0.1)]
    assert told[-1] == 0
    assert told[0] is None


def test_a_way_that_was_none_leads_through_no_door():
    maps, portals = chain(2)
    told = []
    for otherwise in (False, True):
        doors = watched(maps, portals, 0)
        for x in (3.5, 4.2):  # over the threshold, and not yet well beyond
            doors.gone_through(np.array([x, 0.0, 0.0]))
        if otherwise:  # it came past the door, three metres beside it
            doors.rewatch([np.array([x, 3.0, 0.0]) for x in (3.5, 4.2)])
        told.append(doors.gone_through(np.array([4.5, 3.0, 0.0])))
    assert told == [0, None]


def test_who_passes_beside_a_door_or_turns_back_has_not_left():
    maps, portals = chain(2)
    doors = watched(maps, portals, 0)
    assert [doors.gone_through(np.array([x, 2.0, 0.0])) for x in (3.0, 3.9, 4.1, 5.0)] == [None] * 4
    doors = watched(maps, portals, 0)
    way = (3.5, 4.2, 3.8, 3.0)
    assert [doors.gone_through(np.array([x, 0.0, 0.0])) for x in way] == [None] * 4


def test_sparse_scans_cross_a_door_in_one_step():
    maps, portals = chain(2)
    doors = watched(maps, portals, 0)
    assert doors.gone_through(np.array([3.3, -0.2, 0.0])) is None
    assert doors.gone_through(np.array([5.0, 0.3, 0.0])) == 0


def test_a_way_that_was_come_before_the_area_was_known_is_replayed():
    maps, portals = chain(2)
    doors = watched(maps, portals, 0)
    doors.replay([np.array([x, 0.0, 0.0]) for x in (3.5, 3.9, 4.1)])
    assert doors.gone_through(np.array([4.6, 0.0, 0.0])) == 0


def test_a_door_leads_out_of_an_area_one_way_only():
    maps, portals = chain(2)
    doors = watched(maps, portals, 0)
    there = np.array([4.1, 0.1, -0.5 * np.pi])
    assert doors.leads_out(there)
    assert not doors.leads_out(there + np.array([0.0, 0.0, np.pi]))
    assert not doors.leads_out(there + np.array([1.5, 0.0, 0.0]))
    assert not watched(maps, portals, 1).leads_out(np.array([0.0, 0.0, -0.5 * np.pi]))


def test_links_that_are_no_doors_are_not_watched():
    maps, portals = chain(2)
    links = [replace(p, kind="same") for p in portals]
    doors = watched(maps, links, 0)
    assert [doors.gone_through(np.array([x, 0.0, 0.0])) for x in (3.5, 4.5, 5.0)] == [None] * 3


def test_frames_are_composed_through_the_anchors_with_their_covariance():
    maps, portals = chain(4)
    found = relative_frames(0, maps, portals)
    for i in (1, 2, 3):
        assert found[i].pose == pytest.approx([4.0 * i, 0.0, 0.0])
    # Three independent steps: sideways they add up, and turns act on the way that follows.
    expected = 3 * NOISE[1, 1] + NOISE[2, 2] * (0**2 + 4**2 + 8**2) + 3 * NOISE[0, 0]
    assert found[3].at(np.array([12.0, 0.0])) ** 2 == pytest.approx(expected)
    assert found[1].at(np.array([4.0, 0.0])) < found[2].at(np.array([8.0, 0.0]))


def test_ways_that_are_known_are_known_again_until_the_area_changes():
    maps, portals = chain(4)
    ways = Ways()
    relative_frames(0, maps, portals, ways)
    V = maps[1].V
    maps[1] = maps[1]._replace(V=V._replace(covariance=4.0 * V.covariance))
    for here in (0, 2):
        again, anew = (relative_frames(here, maps, portals, *w) for w in ((ways,), ()))
        assert again.keys() == anew.keys() == set(range(4)) - {here}
        for i, frame in anew.items():
            assert np.array_equal(again[i].pose, frame.pose)
            assert np.array_equal(again[i].covariance, frame.covariance)


def test_frames_seen_from_another_area_are_the_inverse():
    maps, portals = chain(3)
    there = relative_frames(0, maps, portals)[2].pose
    back = relative_frames(2, maps, portals)[0].pose
    assert se2.compose(there, back) == pytest.approx(np.zeros(3), abs=1e-12)


def test_good_doors_are_doors():
    maps, portals = chain(3)
    rooms = decided(maps, portals)
    assert rooms.parts == ((0,), (1,), (2,))
    assert rooms.door == (0, 1)
    assert rooms.refused == ()


def test_a_door_without_walls_is_refused_and_the_areas_are_one():
    maps, portals = chain(3)
    weak = chain(3, wall=0.3)[1][0]
    rooms = decided(maps, [weak, portals[1]])
    assert rooms.parts == ((0, 1), (2,))
    assert rooms.door == (None, 1)
    assert rooms.portals[0].kind == "same"
    assert [r.portal for r in rooms.refused] == [0]
    assert "wall" in rooms.refused[0].reason


def test_a_door_that_the_robot_came_round_is_none():
    maps, portals = chain(2)
    p = portals[0]
    link = Portal(0, p.anchor_a, 1, p.anchor_b, "same", ACROSS, 0.0, 0.0, 0.0)
    rooms = decided(maps, [p, link])
    assert rooms.parts == ((0, 1),)
    assert "another way" in rooms.refused[0].reason


def test_a_nook_joins_its_neighbour_by_the_weaker_door():
    maps, portals = chain(3)
    weaker = chain(3, wall=1.2)[1][1]
    rooms = decided(maps, [portals[0], weaker], sizes=[4.0, 1.0, 4.0])
    assert rooms.parts == ((0,), (1, 2))
    assert rooms.door == (0, None)
    assert "small" in rooms.refused[0].reason


def test_a_cut_for_size_is_no_door():
    maps, portals = chain(2)
    p = portals[0]
    cut = Portal(0, p.anchor_a, 1, p.anchor_b, "size", ACROSS, 2.0, 0.0, 0.0)
    rooms = decided(maps, [cut])
    assert rooms.parts == ((0, 1),)
    assert rooms.refused == ()


def test_one_door_found_twice_is_one_door_with_all_its_crossings():
    maps, portals = chain(2, crossings=2)
    again = chain(2, wall=1.5)[1][0]
    rooms = decided(maps, [again, portals[0]])
    assert rooms.door == (1, 1)
    assert [p.kind for p in rooms.portals] == ["open", "door"]
    assert rooms.portals[1].crossings == 3
