"""Narrow places on the path: doors against furniture."""

from __future__ import annotations

import numpy as np
import pytest

from hiermap_cli.config import DoorConfig, LaserConfig
from hiermap_cli.geometry import se2
from hiermap_cli.logs.records import LaserGeometry, Mount, ScanBlock
from hiermap_cli.mapping.topology.again import door_hidden, door_missed, door_of
from hiermap_cli.mapping.topology.chords import narrowest_chord
from hiermap_cli.mapping.topology.door_evidence import demanded, is_door, needed, reach_of
from hiermap_cli.mapping.topology.near_ends import NearEnds
from hiermap_cli.mapping.topology.passage import Passage
from hiermap_cli.mapping.topology.passages import (
    PassageDetector,
    aligned,
    line_evidence,
)
from hiermap_cli.mapping.topology.trace import KEPT, Trace
from hiermap_cli.perception.sight import REACH, Sight, sights

# Two rooms and a wall 0.2 m thick between them at x = 0, with a door 0.9 m wide.
JAMBS = (-0.45, 0.45)
ROOMS = [
    [(-4, -3), (-0.1, -3)], [(-4, 3), (-0.1, 3)], [(-4, -3), (-4, 3)],
    [(0.1, -3), (4, -3)], [(0.1, 3), (4, 3)], [(4, -3), (4, 3)],
]  # fmt: skip
WALL = [
    [(-0.1, -3), (-0.1, JAMBS[0])], [(0.1, -3), (0.1, JAMBS[0])],
    [(-0.1, JAMBS[0]), (0.1, JAMBS[0])], [(-0.1, 3), (-0.1, JAMBS[1])],
    [(0.1, 3), (0.1, JAMBS[1])], [(-0.1, JAMBS[1]), (0.1, JAMBS[1])],
]  # fmt: skip
OUTSIDE = [[(-4, -3), (4, -3)], [(-4, 3), (4, 3)], [(-4, -3), (-4, 3)], [(4, -3), (4, 3)]]


def box(x, y, w, h):
    corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
    return [[corners[i], corners[(i + 1) % 4]] for i in range(4)]


FURNITURE = OUTSIDE + box(-0.25, -0.95, 0.5, 0.5) + box(-0.25, 0.45, 0.5, 0.5)


def look(pose, walls, fov=np.pi, beams=181):
    """What a laser at the robot's origin sees of the walls."""
    angles = np.linspace(-0.5 * fov, 0.5 * fov, beams)
    a = np.array(walls, dtype=float)[:, 0]
    edge = np.array(walls, dtype=float)[:, 1] - a
    d = np.stack((np.cos(angles + pose[2]), np.sin(angles + pose[2])), axis=1)[:, None]
    away = a - pose[:2]
    cross = d[..., 0] * edge[:, 1] - d[..., 1] * edge[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (away[:, 0] * edge[:, 1] - away[:, 1] * edge[:, 0]) / cross
        s = (away[:, 0] * d[..., 1] - away[:, 1] * d[..., 0]) / cross
    r = np.where((t > 1e-9) & (s >= 0) & (s <= 1), t, np.inf).min(axis=1)
    seen = np.isfinite(r)
    ends = r[seen, None] * np.stack((np.cos(angles[seen]), np.sin(angles[seen])), axis=1)
    return Sight(np.zeros(2), ends)


def straight(start=(-2.5, 0.0), heading=0.0, length=4.5, step=0.1):
    n = round(length / step) + 1
    at = np.arange(n) * step
    return np.column_stack(
        (start[0] + at * np.cos(heading), start[1] + at * np.sin(heading), np.full(n, heading))
    )


def drive(poses, walls, **changed):
    """The passages told on a way through walls; changed: of the configuration."""
    trace, detector, told = Trace(), PassageDetector(DoorConfig(**changed)), []
    before = poses[0]
    for pose in poses:
        step = float(np.hypot(*(pose[:2] - before[:2])))
        trace.add(pose, step, look(pose, walls))
        passage = detector.passed(trace)
        if passage is not None:
            told.append(passage)
        before = pose
    return told, trace


def test_a_door_is_told_once_with_its_place_width_and_walls():
    (door,), _ = drive(straight(), ROOMS + WALL)
    assert door.frame[:2] == pytest.approx([0.0, 0.0], abs=0.15)
    assert abs(se2.wrap(door.frame[2] + 0.5 * np.pi)) < 0.15  # Y in the direction of crossing
    assert door.width == pytest.approx(0.9, abs=0.1)
    assert door.evidence > 2.0
    assert door.evidence >= DoorConfig().min_evidence * needed(door.width)


@pytest.mark.parametrize("slant", [-0.6, -0.3, 0.3, 0.6])
def test_a_door_passed_at_a_slant_is_the_same_door(slant):
    start = (-2.2 * np.cos(slant), -2.2 * np.sin(slant))
    (door,), _ = drive(straight(start, slant, 3.9), ROOMS + WALL)
    assert door.frame[:2] == pytest.approx([0.0, 0.0], abs=0.2)
    assert door.width < 1.05
    assert door.evidence > 1.5


def test_a_gap_between_furniture_is_narrow_but_no_door():
    told, _ = drive(straight(), FURNITURE)
    assert told
    for passage in told:
        assert passage.evidence < DoorConfig().min_evidence * needed(passage.width)


def drive_past_someone(walls, person, until):
    """As `drive`, with a person who stays until the robot is there, in metres of path.

    Returns the passages, the doors that they are, and the trace at the end.
    """
    told, doors, _, trace = drive_among(lambda s: walls + person if s < until else walls)
    return told, doors, trace


def drive_among(walls_at):
    """As `drive`, where what stands about depends on the metres of path.

    Returns the passages, the doors that they are, those that were hidden, and the trace.
    """
    trace, detector, told, doors, hidden = Trace(), PassageDetector(DoorConfig()), [], [], []
    before = None
    for k, pose in enumerate(straight()):
        here = walls_at(0.1 * k)
        step = 0.0 if before is None else float(np.hypot(*(pose[:2] - before[:2])))
        trace.add(pose, step, look(pose, here, fov=2 * np.pi, beams=360))
        passage = detector.passed(trace)
        if passage is not None:
            told.append(passage)
            door = door_of(passage, detector, trace, DoorConfig())
            doors += [] if door is None else [door]
        door = door_hidden(detector, trace, DoorConfig())
        hidden += [] if door is None else [door]
        before = pose
    return told, doors, hidden, trace


def test_a_door_is_found_though_someone_stood_in_it_until_the_robot_came():
    someone = box(0.5, -0.5, 0.4, 0.3)  # beyond the door, to the right of the way
    told, doors, trace = drive_past_someone(ROOMS + WALL, someone, 2.6)
    enough = DoorConfig().min_evidence
    assert all(one.evidence < enough * needed(one.width) for one in told)  # chords to the person
    assert told
    assert len(doors) == 1
    for door in (*doors, door_missed(trace, DoorConfig())):
        assert door.frame[:2] == pytest.approx([0.0, 0.0], abs=0.2)
        assert door.width == pytest.approx(0.9, abs=0.12)
        assert door.evidence > 2.0


STANDING = box(0.6, 0.7, 1.0, 0.3) + box(0.6, -0.7, 1.0, 0.3)  # on both sides behind the door


@pytest.mark.parametrize("until", [2.6, 2.9])
def test_a_door_is_found_though_people_made_the_way_behind_it_as_narrow(until):
    told, doors, hidden, _ = drive_among(lambda s: ROOMS + WALL + (STANDING if s < until else []))
    assert told == doors == []
    (door,) = hidden
    assert door.frame[:2] == pytest.approx([0.0, 0.0], abs=0.2)
    assert door.width == pytest.approx(0.9, abs=0.12)


@pytest.mark.parametrize("until", [2.6, 9.0])
def test_a_wall_and_someone_who_leaves_are_no_door(until):
    half = OUTSIDE + box(-0.1, 0.45, 0.2, 2.55)
    someone = box(-0.2, -1.1, 0.4, 0.65)
    told, doors, _ = drive_past_someone(half, someone, until)
    (narrow,) = told
    assert narrow.evidence > DoorConfig().min_evidence * needed(narrow.width)
    assert doors == ([] if until < 9.0 else [narrow])  # who stays is furniture


@pytest.mark.parametrize("walls", [FURNITURE, ROOMS + WALL + STANDING])
def test_what_stays_hides_no_door(walls):
    assert drive_among(lambda _: walls)[2] == []


def test_a_gap_in_furniture_is_no_door_because_people_left():
    _, doors, hidden, _ = drive_among(lambda s: FURNITURE + (STANDING if s < 2.6 else []))
    assert doors == hidden == []


def test_furniture_is_not_asked_for_twice():
    told, doors, trace = drive_past_someone(FURNITURE, [], 0.0)
    assert told
    assert doors == []
    assert door_missed(trace, DoorConfig()) is None


def test_an_empty_room_has_no_narrow_place():
    told, _ = drive(straight(), OUTSIDE)
    assert told == []


def test_who_turns_round_behind_a_door_has_not_gone_through():
    out, back = straight(length=2.8), straight((0.3, 0.0), np.pi, 2.6)
    spin = np.column_stack((np.full(12, 0.3), np.zeros(12), np.linspace(0.2, np.pi, 12)))
    told, _ = drive(np.vstack((out, spin, back)), ROOMS + WALL)
    assert told == []


def test_a_wide_opening_needs_more_wall():
    assert needed(0.7) == needed(1.0) == 1.0
    assert needed(1.6) == 1.6


@pytest.mark.parametrize("reach", [0.8, 1.0, 1.2])
def test_a_leaf_that_stands_open_hides_no_door(reach):
    """Nearly as long as the door is wide: the path widens behind it only."""
    leaf = [[(0.1, JAMBS[0]), (0.9, JAMBS[0])]]
    (door,), _ = drive(straight(), ROOMS + WALL + leaf, reach=reach)
    assert is_door(door, DoorConfig(reach=reach))
    assert door.frame[:2] == pytest.approx([0.0, 0.0], abs=0.2)


def test_a_place_widens_within_a_leaf_at_least():
    short, long = DoorConfig(reach=0.5), DoorConfig(reach=1.3)
    assert reach_of(0.7, short) == pytest.approx(0.8)
    assert reach_of(1.5, short) == pytest.approx(1.0)  # no leaf is so long
    assert reach_of(0.7, long) == reach_of(1.5, long) == 1.3


def test_a_doorway_wider_than_doors_has_wall_beside_it():
    """By a fifth of a metre: between walls it is one, between furniture no narrow place at all."""
    narrow = {"max_width": 0.75}
    (door,), _ = drive(straight(), ROOMS + WALL, **narrow)
    assert door.width > 0.75
    assert is_door(door, DoorConfig(**narrow))
    assert demanded(0.9, DoorConfig(**narrow)) > demanded(0.9, DoorConfig()) == 0.75
    assert drive(straight(), FURNITURE, **narrow)[0] == []
    assert drive(straight(), ROOMS + WALL, max_width=0.6)[0] == []


def test_the_narrowest_chord_has_both_its_ends_on_what_was_seen():
    ends = np.array([[0.0, 0.5], [0.1, -0.4], [1.0, 0.0], [-1.2, 0.1]])
    width, jambs = narrowest_chord(np.zeros(2), ends)
    assert width == pytest.approx(0.5 + np.hypot(0.1, 0.4))
    assert {tuple(j) for j in jambs} == {(0.0, 0.5), (0.1, -0.4)}


def test_a_chord_into_the_open_is_as_long_as_is_looked_for():
    width, jambs = narrowest_chord(np.zeros(2), np.array([[5.0, 5.0]]))
    assert width == pytest.approx(3.2)
    assert np.hypot(*(jambs[0] - jambs[1])) == pytest.approx(3.2, abs=0.4)


def test_the_line_is_wall_where_beams_end_and_open_where_they_pass():
    origins, ends = np.full((400, 2), [0.0, -2.0]), np.zeros((400, 2))
    ends[:, 0] = np.linspace(-2.0, 2.0, 400)
    ends[200:, 1] = 2.0  # to the right they go on
    wall, opened = line_evidence(np.zeros(3), 0.0, origins, ends)
    assert wall[0] == pytest.approx(1.2)
    assert opened[1] == pytest.approx(0.0 + 1.0, abs=0.3)
    assert wall[1] == opened[0] == 0.0


def test_a_frame_is_turned_along_the_wall():
    _, trace = drive(straight(), ROOMS + WALL)
    askew = np.array([0.0, 0.0, -0.5 * np.pi + 0.3])
    found, wall, opened = aligned(askew, 0.9, *trace.rays(0.0))
    assert abs(se2.wrap(found[2] + 0.5 * np.pi)) < abs(0.3)
    assert wall.sum() > 2.0
    assert opened.sum() < 0.3


def test_a_trace_moves_with_the_frame_and_forgets_what_is_far_behind():
    _, trace = drive(straight(length=6.0, start=(-3.0, 0.0)), OUTSIDE)
    assert trace.travelled[0] >= trace.length - 5.0 - 1e-9
    before = trace.rays(0.0)[1].copy()
    R = np.array([1.0, 2.0, 0.5])
    trace.move(R)
    c, s = np.cos(0.5), np.sin(0.5)
    assert trace.rays(0.0)[1] == pytest.approx(R[:2] + before @ np.array([[c, s], [-s, c]]))
    told = trace.older(-1.0)
    assert told
    assert trace.older(-1.0) == []


def test_the_evidence_of_a_passage_is_wall_less_opening():
    passage = Passage(np.zeros(3), 1.0, 0.0, np.array([0.8, 0.7]), np.array([0.2, 0.1]))
    assert passage.evidence == pytest.approx(1.2)


@pytest.mark.parametrize("flipped", [False, True])
def test_sights_keep_the_nearest_of_neighbouring_beams(flipped):
    laser = LaserGeometry(-1.0, 0.01, 201, 0.05, 30.0)
    ranges = np.full((1, 201), 4.0, np.float32)
    ranges[0, 10] = 1.0
    ranges[0, 60:70] = np.inf
    ranges[0, 100:110] = np.nan
    ranges[0, 150:160] = 25.0
    block = ScanBlock(
        np.zeros(1, np.int64), ranges, np.zeros((1, 3)), np.ones(1, bool), laser,
        Mount(x=0.2, y=0.1, flipped=flipped),
    )  # fmt: skip
    (sight,) = list(sights(block, LaserConfig()))
    far = np.hypot(*(sight.ends - sight.origin).T)
    assert sight.origin == pytest.approx([0.2, 0.1])
    assert far.min() == pytest.approx(1.0)
    assert far.max() <= REACH + 1e-6
    near = sight.ends[np.argmin(far)] - sight.origin
    assert np.arctan2(near[1], near[0]) == pytest.approx(0.9 if flipped else -0.9)
    assert len(sight.ends) < 201 / 2


def test_a_chord_is_exact_as_far_as_it_is_asked_for():
    """Ends that cannot belong to a chord short enough are left out, and change nothing."""
    rng = np.random.default_rng(4)
    short = 0
    for spread in np.linspace(0.5, 2.0, 60):
        angle, r = rng.uniform(-np.pi, np.pi, 300), spread * rng.uniform(0.6, 1.4, 300)
        ends = np.stack((r * np.cos(angle), r * np.sin(angle)), axis=1)
        width, jambs = narrowest_chord(np.zeros(2), ends)
        asked, found = narrowest_chord(np.zeros(2), ends, 2.05)
        if width <= 2.05:
            short += 1
            assert asked == width
            assert np.array_equal(found, jambs)
        else:
            assert asked > 2.05
    assert 10 < short < 50


def test_ends_of_the_last_scans_are_those_added():
    """However often the store is filled up, forgotten and moved."""
    rng = np.random.default_rng(1)
    store, expected, none = NearEnds(), [], np.zeros((0, 2))
    for k in range(400):
        points = rng.uniform(-3.0, 3.0, (int(rng.integers(0, 60)), 2))
        store.append(points)
        expected.append(points)
        if k % 7 == 0:
            old = int(rng.integers(0, len(expected)))
            del store[:old], expected[:old]
        if k % 11 == 0:
            young = int(rng.integers(len(expected) // 2, len(expected) + 1))
            del store[young:], expected[young:]
        if k % 50 == 0:
            R = rng.uniform(-2.0, 2.0, 3)
            store.move(R)
            expected = [R[:2] + points @ se2.rotation(R[2]).T for points in expected]
        assert len(store) == len(expected)
        since = int(rng.integers(0, len(expected) + 1))
        assert store.since(since) == pytest.approx(np.concatenate([none, *expected[since:]]))
    assert store.since(len(expected)).shape == (0, 2)


def test_only_the_last_metres_are_remembered():
    trace = Trace()
    for _ in range(200):
        trace.add(np.array([trace.length, 0.0, 0.0]), 0.1, Sight(np.zeros(2), np.ones((3, 2))))
    assert trace.travelled[0] >= trace.length - KEPT
    assert len(trace.poses) == len(trace.ends) == pytest.approx(KEPT / 0.1, abs=2)
    assert np.array_equal(trace.way.since(0), np.array(trace.poses)[:, :2])
    assert len(trace.near.since(0)) < 3 * len(trace.poses)
