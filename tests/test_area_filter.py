"""One step of an area's filter: what is matched, what is corrected, what is new, what is lost."""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import COORDINATES, UPDATES, error_of, room, view_from, whole_room

from hiermap_cli.config import AssociationConfig, Config, FilterConfig, ForgetConfig
from hiermap_cli.estimation.motion import LASER_X, motion
from hiermap_cli.estimation.stochastic_map import initial_map, predict
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, EMPTY, END, WALL, AreaMap
from hiermap_cli.mapping.association.area_filter import forget_unseen, observe
from hiermap_cli.mapping.association.matching import associate
from hiermap_cli.mapping.portals import add_anchor
from hiermap_cli.perception.segments import END_FREE, END_OPEN, END_VERTEX

CONFIG = Config()


def empty_area(coordinates="invariant", sigma=0.0):
    V = initial_map(np.zeros(3), sigma**2 * np.eye(3), np.zeros(4), 1e-4 * np.eye(4), coordinates)
    return AreaMap(V, EMPTY)


def robot_at(area, pose, sigma=None):
    """The area with its robot elsewhere, and as unsure of it as said."""
    poses, P = area.V.poses.copy(), area.V.covariance.copy()
    poses[0] = pose
    if sigma is not None:
        P[:3], P[:, :3] = 0.0, 0.0
        P[:3, :3] = sigma**2 * np.eye(3)
    return area._replace(V=area.V._replace(poses=poses, covariance=P))


def looked(area, view, keys=(0, 1), config=CONFIG):
    """The area after the same view in several scans: an end enters when it is seen again."""
    for key in keys:
        area = observe(area, view, key, config).area
    return area


def ends_of(area):
    return np.flatnonzero(area.features.kind == END)


# --- what is new ---


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_the_first_scan_founds_walls_and_ends(coordinates):
    truth = room(robot=(0.5, -0.3, 0.7))
    view = whole_room(truth, vertices=True)
    step = observe(empty_area(coordinates), view, 0, CONFIG)
    f, V = step.area.features, step.area.V
    assert step.matches.empty()
    assert step.degrees == 0
    assert step.surprise is None
    assert (f.kind == WALL).sum() == 4
    assert V.poses[1:5] == pytest.approx(se2.between(truth.V.robot, truth.V.poses[1:]), abs=1e-9)
    assert f.seen.tolist() == [1, 1, 1, 1]
    # Ends are there from the second scan on, each on its side of its wall.
    area = looked(step.area, view, (1,))
    f, V = area.features, area.V
    assert len(ends_of(area)) == 8
    for i in ends_of(area):
        wall = int(np.flatnonzero(f.uid == f.wall[i])[0])
        reach = [f.lo[wall], f.hi[wall]][f.side[i]]
        seen = se2.between(V.poses[1 + wall], V.poses[1 + i])
        assert seen == pytest.approx([reach, 0.0, 0.0], abs=1e-9)
    assert np.linalg.eigvalsh(V.covariance).min() > -1e-12


def test_an_end_is_let_in_when_it_is_seen_again_soon_and_at_the_same_place():
    truth = room(sigma=1e-6)
    patience = CONFIG.filter.end_patience
    view = view_from(truth, [(0, -3.0, 1.0)], [(END_OPEN, END_FREE)])
    elsewhere = view_from(truth, [(0, -3.0, 1.3)], [(END_OPEN, END_FREE)])
    once = looked(truth, view, (0,))
    assert len(ends_of(once)) == 0
    assert len(ends_of(looked(once, view, (patience,)))) == 1
    assert len(ends_of(looked(once, view, (patience + 1,)))) == 0
    assert len(ends_of(looked(once, elsewhere, (1,)))) == 0
    (end,) = ends_of(looked(looked(once, elsewhere, (1,)), view, (2,)))
    assert end == 4


def test_open_ends_are_no_ends():
    truth = room()
    parts = [(0, -3.0, 3.0), (1, -2.0, 2.0)]
    kinds = [(END_OPEN, END_VERTEX), (END_FREE, END_OPEN)]
    area = looked(empty_area(), view_from(truth, parts, kinds))
    f, ends = area.features, ends_of(area)
    assert f.wall[ends].tolist() == [0, 1]
    assert f.side[ends].tolist() == [1, 0]


def test_short_segments_found_no_wall_and_very_short_ones_are_not_offered():
    c = CONFIG.filter
    truth = room()
    short = 0.5 * (c.min_match_length + c.min_new_length)
    shorter = 0.9 * c.min_match_length
    view = view_from(truth, [(0, 0.0, short), (1, 0.0, shorter), (2, -1.0, 1.0)])
    step = observe(empty_area(), view, 0, CONFIG)
    assert step.offered == 2
    assert len(step.area.features.uid) == 1
    known = observe(truth, view, 0, CONFIG)
    assert known.matches.segment.tolist() == [0, 2]


def test_another_end_of_a_known_wall_is_let_in_unless_it_is_beside_a_known_one():
    """A jamb seen later; an end that fails its gate is no second one beside the first."""
    truth = room(sigma=1e-6)
    whole = view_from(truth, [(0, -3.0, 3.0)], [(END_OPEN, END_VERTEX)])
    area = looked(truth, whole)
    assert len(ends_of(area)) == 1
    jamb = view_from(truth, [(0, -3.0, 1.0)], [(END_OPEN, END_FREE)])
    both = looked(area, jamb, (2, 3))
    assert len(ends_of(both)) == 2
    near = 0.4 * CONFIG.filter.end_spacing
    beside = view_from(truth, [(0, -3.0, 1.0 + near)], [(END_OPEN, END_FREE)])
    assert not len(observe(both, beside, 4, CONFIG).matches.end)
    assert len(ends_of(looked(both, beside, (4, 5)))) == 2


# --- what is matched ---


@pytest.mark.parametrize("coordinates", COORDINATES)
@pytest.mark.parametrize("update", UPDATES)
def test_a_robot_a_little_off_is_put_right(coordinates, update):
    config = Config(update=update, coordinates=coordinates)
    truth = room(robot=(0.4, -0.5, 0.3), coordinates=coordinates)
    view = whole_room(truth)
    off = robot_at(truth, [0.5, -0.42, 0.26], sigma=0.1)
    step = observe(off, view, 3, config)
    assert step.matches.wall.tolist() == [0, 1, 2, 3]
    assert step.offered == 4
    assert step.degrees == 8
    assert step.area.V.robot == pytest.approx(truth.V.robot, abs=0.01)
    sigma = np.sqrt(np.diagonal(step.area.V.pose_covariance(0)))
    assert sigma.max() < 0.02
    assert step.area.features.seen.tolist() == [6, 6, 6, 6]
    assert step.area.features.last.tolist() == [3, 3, 3, 3]
    assert len(step.area.features.uid) == 4  # nothing is founded twice


def test_what_is_not_in_sight_moves_with_what_is():
    """A wall behind the robot, known with the same error as the one ahead."""
    area = room(sigma=1e-4)
    P = area.V.covariance.copy()
    common = np.zeros((len(P), 1))
    for wall in range(4):
        common[area.V.columns(1 + wall)][:2] = 0.05  # the whole room, not the robot
    area = area._replace(V=area.V._replace(covariance=P + common @ common.T))
    truth = room()
    shift = np.array([0.04, 0.04, 0.0])
    truth = truth._replace(
        V=truth.V._replace(poses=truth.V.poses + np.vstack((np.zeros(3), *[shift] * 4)))
    )
    view = view_from(truth, [(0, -2.0, 2.0), (1, -1.0, 1.0)])
    after = observe(area, view, 1, CONFIG).area.V
    for wall in (2, 3):
        moved = after.poses[1 + wall] - area.V.poses[1 + wall]
        assert moved == pytest.approx(shift, abs=0.01)


def test_the_lasers_place_is_found():
    """Odometry that turns on the spot, while the robot goes round a point 6 cm behind it."""
    area = room(sigma=1e-5)
    P = area.V.covariance.copy()
    P[3:7, 3:7] = np.diag([1e-12, 1e-12, 1e-12, 0.1**2])
    area = area._replace(V=area.V._replace(covariance=P))
    L = np.array([0.06, 0.0, 0.0])
    centre = se2.compose(area.V.robot, se2.invert(L))
    for key in range(12):
        increment = np.array([0.0, 0.0, 0.5])
        centre = se2.compose(centre, increment)
        told = motion(increment, area.V.parameters, CONFIG.odometry)
        area = area._replace(V=predict(area.V, told))
        view = whole_room(room(robot=tuple(se2.compose(centre, L))))
        area = observe(area, view, key, CONFIG).area
    assert area.V.parameters[LASER_X] == pytest.approx(0.06, abs=0.01)
    assert np.sqrt(area.V.covariance[3 + LASER_X, 3 + LASER_X]) < 0.01


def test_two_pieces_of_one_wall_are_that_wall():
    truth = room()
    view = view_from(truth, [(0, -2.5, -0.6), (0, 0.4, 2.5), (1, -1.0, 1.0)])
    step = observe(robot_at(truth, [0.02, 0.01, 0.01], 0.02), view, 1, CONFIG)
    assert step.matches.wall.tolist() == [0, 0, 1]
    assert len(step.area.features.uid) == 4
    assert step.area.features.seen[0] == 6  # once a scan


def test_a_walls_extent_grows_with_what_is_seen_of_it():
    truth = room()
    known = truth.features._replace(lo=np.full(4, -0.5), hi=np.full(4, 0.5))
    area = truth._replace(features=known)
    view = view_from(truth, [(0, -0.2, 2.4), (2, -1.2, 0.1)])
    f = observe(area, view, 1, CONFIG).area.features
    assert f.lo[[0, 2]] == pytest.approx([-0.5, -1.2], abs=0.01)
    assert f.hi[[0, 2]] == pytest.approx([2.4, 0.5], abs=0.01)


def test_a_wall_is_not_its_other_face():
    """A segment on the line of a wall, but with the free side beyond it, is another wall."""
    truth = room()
    view = view_from(truth, [(0, -1.5, 1.5)])
    back = view._replace(theta=view.theta + np.pi, ends=view.ends[:, ::-1])
    step = observe(truth, back, 1, CONFIG)
    assert step.matches.empty()
    assert len(step.area.features.uid) == 5


def test_a_segment_beyond_a_walls_extent_is_not_that_wall():
    truth = room()
    gap = CONFIG.association.max_gap
    near = view_from(truth, [(0, 3.0 + 0.5 * gap, 5.0)])
    far = view_from(truth, [(0, 3.0 + 1.5 * gap, 5.0)])
    assert observe(truth, near, 1, CONFIG).matches.wall.tolist() == [0]
    assert observe(truth, far, 1, CONFIG).matches.empty()


def test_a_scan_that_matches_nothing_is_not_forced():
    """A room turned by 45 degrees: no match, the robot is left where it was predicted to be."""
    truth = room()
    strange = room(robot=(0.0, 0.0, 0.25 * np.pi), width=5.0, depth=5.0)
    step = observe(robot_at(truth, [0.0, 0.0, 0.0], 0.1), whole_room(strange), 1, CONFIG)
    assert step.matches.empty()
    assert step.offered == 4
    assert np.array_equal(step.area.V.robot, np.zeros(3))
    n = len(truth.V.covariance)
    before = robot_at(truth, [0.0, 0.0, 0.0], 0.1).V.covariance
    assert np.array_equal(step.area.V.covariance[:n, :n], before)
    assert step.nis == 0.0


def test_a_segment_that_contradicts_the_others_is_left_out():
    """A cupboard 12 cm before a wall passes its own gate, as the robot is unsure by more than
    that; together with the other walls it does not."""
    truth = room()
    view = whole_room(truth)
    normal = np.array([0.0, 1.0])
    ends, centre = view.ends.copy(), view.centre.copy()
    ends[0] += 0.12 * normal
    centre[0] += 0.12 * normal
    ends[0, :, 0] *= 0.3
    view = view._replace(ends=ends, centre=centre)
    area = robot_at(truth, [0.03, 0.02, 0.0], 0.08)
    # Alone it would pass.
    alone = type(view)(*(column[:1] for column in view))
    assert associate(area, alone, CONFIG.association, CONFIG.filter).matches.wall.tolist() == [0]
    step = observe(area, view, 1, CONFIG)
    assert step.matches.wall.tolist() == [1, 2, 3]
    assert step.area.V.robot == pytest.approx(np.zeros(3), abs=0.01)
    # What is so near to a wall does not found another beside it.
    assert len(step.area.features.uid) == 4


def test_every_known_end_is_matched_to_the_nearest_end_seen_and_once():
    truth = room(sigma=1e-3)
    area = looked(truth, whole_room(truth, vertices=True))
    ends = ends_of(area)
    assert len(ends) == 8
    # Two pieces of wall 0 with four ends near the two known ones.
    parts = [(0, -3.0, -1.0), (0, -0.9, 2.98)]
    view = view_from(truth, parts, [(END_VERTEX, END_OPEN), (END_FREE, END_VERTEX)])
    step = observe(area, view, 2, CONFIG)
    assert sorted(step.matches.end.tolist()) == sorted(ends[:2].tolist())
    assert step.matches.end_segment.tolist() == [0, 1]
    assert step.matches.end_side.tolist() == [0, 1]
    # The third, in the middle of the wall, is new.
    assert len(ends_of(looked(step.area, view, (3,)))) == len(ends) + 1


def test_gates_are_chi_square_gates():
    """A wall seen off by a little less, and a little more, than its gate."""
    area = robot_at(room(sigma=0.0), np.zeros(3), 0.0)
    sigma = 0.01
    gate = np.sqrt(2.0 * np.log(1.0 / (1.0 - CONFIG.association.gate)))  # of two degrees
    for factor, matched in ((0.97, 1), (1.03, 0)):
        truth = room()
        view = view_from(truth, [(0, -1.0, 1.0)], sigma=sigma)
        off = np.array([0.0, factor * gate * sigma])
        view = view._replace(ends=view.ends + off, centre=view.centre + off)
        found = associate(area, view, CONFIG.association, CONFIG.filter)
        assert len(found.matches.wall) == matched
        assert found.near.any() == bool(matched)


def test_a_wider_gate_lets_more_through():
    truth = room()
    view = view_from(truth, [(0, -1.0, 1.0)])
    off = np.array([0.0, 0.045])
    view = view._replace(ends=view.ends + off, centre=view.centre + off)
    found = [
        len(associate(truth, view, AssociationConfig(gate=gate), FilterConfig()).matches.wall)
        for gate in (0.9, 0.999999)
    ]
    assert found == [0, 1]


def test_surprise_is_told_where_there_are_rows_enough():
    truth = room()
    few = observe(truth, view_from(truth, [(0, -1.0, 1.0)]), 1, CONFIG)
    assert few.degrees == 2
    assert few.surprise is None
    many = observe(robot_at(truth, [0.01, 0.01, 0.0], 0.02), whole_room(truth), 1, CONFIG)
    assert many.surprise is not None
    assert many.surprise.robot * 3 + many.surprise.rest * 5 == pytest.approx(many.nis)


def test_the_input_is_left_alone():
    area = robot_at(room(), [0.05, 0.0, 0.0], 0.05)
    copies = [np.array(x) for x in (area.V.poses, area.V.covariance, *area.features)]
    observe(area, whole_room(room(), vertices=True), 1, CONFIG)
    for old, new in zip(copies, (area.V.poses, area.V.covariance, *area.features), strict=True):
        assert np.array_equal(old, new)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_a_room_driven_round_without_noise_has_no_error(coordinates):
    """Exact views from twenty poses, exact predictions: walls, ends and robot stay exact."""
    config = Config(coordinates=coordinates)
    start = np.array([1.0, 0.5, 0.4])
    area = empty_area(coordinates)
    for key in range(20):
        pose = np.array([np.cos(0.3 * key), 0.5 * np.sin(0.3 * key), 0.4 + 0.3 * key])
        truth = room(robot=pose, coordinates=coordinates)
        here = se2.between(start, pose) if key else np.zeros(3)
        area = robot_at(area, here, 0.02 if key else None)
        area = observe(area, whole_room(truth, vertices=True), key, config).area
        start = pose if key == 0 else start
        assert np.abs(error_of(coordinates, here, area.V.robot)).max() < 1e-9
    assert len(area.features.uid) == 12
    true = se2.between(start, room().V.poses[1:])
    assert np.abs(area.V.poses[1:5] - true).max() < 1e-9
    assert np.linalg.eigvalsh(area.V.covariance).min() > -1e-12


# --- what is lost ---


def with_counts(area, seen, last):
    f = area.features._replace(seen=np.array(seen), last=np.array(last))
    return area._replace(features=f)


def test_what_is_rarely_seen_is_forgotten_first():
    c = ForgetConfig(patience=5, enough=10)
    area = with_counts(room(), seen=[1, 2, 9, 10], last=[0, 0, 0, 0])
    for key, left in ((5, 4), (6, 3), (10, 3), (11, 2), (45, 2), (46, 1), (10000, 1)):
        after, lost = forget_unseen(area, key, c)
        assert len(after.features.uid) == left
        assert lost == 4 - left
    assert after.features.seen.tolist() == [10]


def test_ends_go_with_their_wall_and_anchors_stay():
    area = looked(room(), whole_room(room(), vertices=True))
    area, _ = add_anchor(area, 1)
    f = area.features
    seen = np.where(f.uid == 0, 1, 100)
    seen[f.kind == ANCHOR] = 1
    area = area._replace(features=f._replace(seen=seen))
    after, lost = forget_unseen(area, 1000, CONFIG.forget)
    assert lost == 3
    assert not np.isin(0, after.features.uid)
    assert not np.isin(0, after.features.wall[after.features.kind == END])
    assert (after.features.kind == ANCHOR).sum() == 1
    assert after.V.objects == len(after.features.uid)


def test_nothing_to_forget_leaves_the_area_itself():
    area = room()
    assert forget_unseen(area, 1, CONFIG.forget) == (area, 0)
