"""Landmarks of an area as functions of its state: pieces of walls, covariances, joined areas."""

import numpy as np
import pytest
from estimation_cases import (
    COORDINATES,
    additive_covariance,
    derivative,
    moved,
    random_covariance,
    walls_area,
)

from hiermap_cli.config import LandmarkConfig
from hiermap_cli.documents.checks import covariance_fault
from hiermap_cli.estimation.stochastic_map import StochasticMap
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, AreaMap
from hiermap_cli.mapping.areas.duplicates import Placed, contains, duplicates
from hiermap_cli.mapping.areas.joining import join
from hiermap_cli.mapping.areas.landmarks import find_landmarks, joint_covariance, landmark_model
from hiermap_cli.mapping.areas.walls import at_vertices, wall_lines, wall_pieces
from hiermap_cli.mapping.levels import change_frame
from hiermap_cli.mapping.portals import Portal
from hiermap_cli.perception.segments import END_VERTEX

CONFIG = LandmarkConfig()
SHIFT = np.array([0.4, -0.7, 0.9])


def room_with_ends(rng, coordinates="invariant", sigma=0.005) -> AreaMap:
    """A room of 5 x 4 m with a door in its first wall: two of five walls are in line.

    The covariance is full, but for the ends' y and theta, which are their walls' by birth.
    """
    walls = np.array(
        [
            [1.0, 0.0, 0.0],
            [3.95, 0.0, 0.0],
            [5.0, 2, np.pi / 2],
            [2.5, 4, np.pi],
            [0, 2, -np.pi / 2],
        ]
    )
    half = [1.0, 1.05, 2.0, 2.5, 2.0]
    ends = [(wall, side) for wall in range(5) for side in (0, 1)]
    along = np.zeros((10, 3))
    along[:, 0] = np.repeat(half, 2) * np.tile([-1.0, 1.0], 5)
    poses = np.concatenate(
        ([[2.0, 1.5, 0.4]], walls, se2.compose(walls[[wall for wall, _ in ends]], along))
    )
    poses = se2.compose(SHIFT, poses)
    m = 4
    P = random_covariance(rng, 3 + m + 3 * (len(poses) - 1), sigma)
    V = StochasticMap(poses, np.zeros(m), P, coordinates)
    return walls_area(V, half, ends)


def landmarks_of(area: AreaMap):
    walls = wall_lines(area.V, area.features, CONFIG)
    return find_landmarks(walls, CONFIG).kept


# --- pieces of walls ---


def pieces(lo, hi, *marks):
    """marks: (x, side, sightings)."""
    x, side, seen = (
        (np.array(column) for column in zip(*marks, strict=True)) if marks else ([],) * 3
    )
    return [
        (round(p.lo, 9), round(p.hi, 9), p.ends)
        for p in wall_pieces(
            lo,
            hi,
            np.arange(10, 10 + len(marks)),
            np.array(x, float),
            np.array(side),
            np.array(seen),
        )
    ]


def test_a_wall_without_ends_is_one_open_piece():
    assert pieces(-1.0, 2.0) == [(-1.0, 2.0, (-1, -1))]


def test_ends_set_how_far_a_wall_goes():
    assert pieces(-1.2, 2.3, (-1.0, 0, 5), (2.0, 1, 5)) == [(-1.0, 2.0, (10, 11))]


def test_a_door_in_a_wall_makes_two_pieces():
    assert pieces(-3.0, 3.0, (-0.5, 1, 5), (0.4, 0, 5)) == [
        (-3.0, -0.5, (-1, 10)),
        (0.4, 3.0, (11, -1)),
    ]


def test_what_was_seen_before_a_wall_begins_is_another_walls():
    assert pieces(-4.0, 1.0, (-1.9, 0, 60)) == [(-1.9, 1.0, (10, -1))]
    assert pieces(-4.0, 3.0, (-1.9, 1, 60)) == [(-4.0, -1.9, (-1, 10))]


def test_of_two_beginnings_the_one_seen_more_often_holds():
    assert pieces(-2.0, 3.0, (-1.0, 0, 9), (0.5, 0, 3), (2.0, 1, 5)) == [(-1.0, 2.0, (10, 12))]
    assert pieces(-2.0, 3.0, (-1.0, 0, 3), (0.5, 0, 9), (2.0, 1, 5)) == [(0.5, 2.0, (11, 12))]


# --- lines and landmarks by the state ---


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_lines_depend_on_the_state_as_they_say(coordinates):
    area = room_with_ends(np.random.default_rng(1), coordinates)
    walls = wall_lines(area.V, area.features, CONFIG)
    assert len(walls.lines) == 5

    def parameters(e):
        lines = wall_lines(moved(area.V, e), area.features, CONFIG).lines
        values = np.column_stack((lines.hesse, lines.along))
        values[:, 2:][lines.kind == 0] = 0.0  # open ends are only how far was seen
        return values.ravel()

    numeric = derivative(parameters, len(area.V.covariance))
    # An end lies on its wall: the two errors are one in the filter, and here they are not. What
    # an end off its wall would do to s is of second order for the filter's own errors.
    np.testing.assert_allclose(walls.by_state, numeric, atol=1e-5)
    expected = walls.by_state @ area.V.covariance @ walls.by_state.T
    np.testing.assert_allclose(walls.lines.covariance, expected, atol=1e-15)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_walls_end_at_the_corners_that_they_make(coordinates):
    area = room_with_ends(np.random.default_rng(1), coordinates)

    def at_corners(V):
        return at_vertices(wall_lines(V, area.features, CONFIG), CONFIG)

    before = wall_lines(area.V, area.features, CONFIG)
    walls = at_corners(area.V)
    # Four corners of two walls each; only the door's jambs are as they were.
    assert (walls.lines.kind == END_VERTEX).sum() == 8
    assert (walls.lines.kind != before.lines.kind).sum() == 8
    ends = walls.lines.ends
    np.testing.assert_allclose(ends[1, 1], ends[2, 0], atol=1e-12)
    numeric = derivative(
        lambda e: at_corners(moved(area.V, e)).lines.along.ravel(), len(area.V.covariance)
    )
    np.testing.assert_allclose(
        walls.by_state.reshape(5, 4, -1)[:, 2:].reshape(10, -1), numeric, atol=1e-5
    )
    assert covariance_fault(walls.lines.covariance) is None


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_landmark_poses_and_shapes_depend_on_the_state_as_they_say(coordinates):
    area = room_with_ends(np.random.default_rng(2), coordinates)
    drafts = landmarks_of(area)
    assert {draft.kind for draft in drafts} == {"corner_concave", "door"}

    def poses(e):
        return np.ravel([draft.pose for draft in landmarks_of(area._replace(V=moved(area.V, e)))])

    expected = np.concatenate([draft.pose_by_state for draft in drafts])
    numeric = derivative(poses, len(area.V.covariance))
    np.testing.assert_allclose(expected, numeric, atol=1e-5)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_models_are_sound_and_tell_the_robot_in_the_landmarks_frame(coordinates):
    area = room_with_ends(np.random.default_rng(3), coordinates)
    drafts = landmarks_of(area)
    C = joint_covariance(area.V, drafts)
    assert covariance_fault(C) is None
    np.testing.assert_allclose(C[:3, :3], area.V.pose_covariance(0), atol=1e-15)
    for k, draft in enumerate(drafts):
        model = landmark_model(area.V, draft, "L7", "A1")
        assert covariance_fault(model.covariance) is None
        assert model.robot.frame == "L7"
        np.testing.assert_allclose(
            se2.compose(draft.pose, model.robot.mean), area.V.robot, atol=1e-12
        )
        # Robot in the landmark's frame, by error propagation from their joint covariance.
        D_pose = se2.compose_D_first(se2.invert(draft.pose), area.V.robot) @ se2.invert_D_pose(
            draft.pose
        )
        D = np.hstack((se2.compose_D_second(se2.invert(draft.pose), area.V.robot), D_pose))
        where = np.r_[0:3, 3 + 3 * k : 6 + 3 * k]
        np.testing.assert_allclose(
            model.robot.covariance, D @ C[np.ix_(where, where)] @ D.T, rtol=1e-9, atol=1e-12
        )
        if draft.kind == "corner_concave":
            variances = np.diagonal(model.covariance)[3:]
            assert (variances == 0.0).sum() == 3
            assert not model.covariance[3:][variances == 0.0].any()


def test_landmarks_that_share_a_wall_are_correlated_through_it():
    area = room_with_ends(np.random.default_rng(4))
    P = np.diag(np.diagonal(area.V.covariance))  # walls that know nothing of each other
    area = area._replace(V=area.V._replace(covariance=P))
    drafts = landmarks_of(area)
    C = joint_covariance(area.V, drafts)
    corners = [k for k, draft in enumerate(drafts) if draft.kind == "corner_concave"]
    assert len(corners) == 4
    for i in corners:
        for j in corners:
            shared = set(drafts[i].lines) & set(drafts[j].lines)
            block = C[3 + 3 * i : 6 + 3 * i, 3 + 3 * j : 6 + 3 * j]
            assert bool(np.abs(block).max() > 1e-12) == bool(shared)


def test_what_is_seen_too_seldom_is_dropped_and_counted():
    area = room_with_ends(np.random.default_rng(5))
    seen = area.features.seen.copy()
    seen[2] = 2  # the wall of two corners
    walls = wall_lines(area.V, area.features._replace(seen=seen), CONFIG)
    few = find_landmarks(walls, CONFIG)
    all_of_them = find_landmarks(wall_lines(area.V, area.features, CONFIG), CONFIG)
    assert few.dropped == 2
    assert len(few.kept) == len(all_of_them.kept) - 2
    assert few.forgotten == 1


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_a_change_of_frame_costs_nothing(coordinates):
    area = room_with_ends(np.random.default_rng(6), coordinates)
    R = np.array([1.0, -2.0, 0.8])
    V = change_frame(area.V, R)
    np.testing.assert_allclose(se2.compose(R, V.poses), area.V.poses, atol=1e-12)
    back = change_frame(V, se2.invert(R))
    np.testing.assert_allclose(back.covariance, area.V.covariance, atol=1e-15)
    # What one pose is to another is as well known as before.
    for one, other in zip(landmarks_of(area), landmarks_of(area._replace(V=V)), strict=True):
        assert one.kind == other.kind
        model = landmark_model(area.V, one, "L1", "A1")
        again = landmark_model(V, other, "L1", "A1")
        np.testing.assert_allclose(again.covariance, model.covariance, rtol=1e-6, atol=1e-12)


# --- joined areas ---


def anchored(rng, uid_pose: np.ndarray, coordinates: str) -> AreaMap:
    """An area with an anchor as its last object."""
    walls = np.array([[1.0, 0.0, 0.0], [2.0, 1.0, np.pi / 2]])
    poses = np.concatenate(([[1.5, 1.5, 0.4]], walls, se2.compose(walls[:1], [[1.0, 0, 0]])))
    P = random_covariance(rng, 3 + 4 + 9, 0.01)
    area = walls_area(StochasticMap(poses, np.zeros(4), P, coordinates), [1.0, 1.0], [(0, 1)])
    V = area.V
    poses = np.concatenate((V.poses, uid_pose[None]))
    P = random_covariance(rng, len(V.covariance) + 3, 0.01)
    f = area.features
    row = [20, ANCHOR, -1, 0, 0.0, 0.0, 1, 0]
    columns = [np.append(column, value) for column, value in zip(f, row, strict=True)]
    return AreaMap(V._replace(poses=poses, covariance=P), type(f)(*columns), 21)


def portal(a: int, b: int, kind: str = "same") -> Portal:
    return Portal(a, 20, b, 20, kind, np.zeros(3), 0.9, 1.0, 0.0)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_joined_areas_have_the_covariance_of_their_parts_errors(coordinates):
    rng = np.random.default_rng(8)
    areas = [
        anchored(rng, np.array([1.0, 0.5, 0.2]), coordinates),
        anchored(rng, np.array([-0.5, 0.2, -1.0]), coordinates),
    ]
    portals = [portal(0, 1)]
    whole = join(areas, portals, (0, 1), 1)
    n = len(areas[0].V.covariance)

    def poses(e):
        both = [
            areas[0]._replace(V=moved(areas[0].V, e[:n])),
            areas[1]._replace(V=moved(areas[1].V, e[n:])),
        ]
        return join(both, portals, (0, 1), 1).map.V.poses.ravel()

    J = derivative(poses, 2 * n)
    C = np.zeros((2 * n, 2 * n))
    C[:n, :n], C[n:, n:] = areas[0].V.covariance, areas[1].V.covariance
    np.testing.assert_allclose(additive_covariance(whole.map.V), J @ C @ J.T, rtol=1e-5, atol=1e-9)
    # The place that both know is one place.
    first, second = whole.map.V.poses[1 + np.flatnonzero(whole.map.features.kind == ANCHOR)]
    np.testing.assert_allclose(first, second, atol=1e-12)
    # The robot is where it was last.
    np.testing.assert_allclose(
        whole.map.V.robot, se2.compose(whole.R_0_p[1], areas[1].V.robot), atol=1e-12
    )
    uids = whole.map.features.uid
    assert len(set(uids.tolist())) == len(uids)
    ends = whole.map.features.wall >= 0
    assert set(whole.map.features.wall[ends].tolist()) <= set(uids.tolist())


def test_areas_that_nothing_joins_cannot_be_joined():
    rng = np.random.default_rng(9)
    areas = [anchored(rng, np.zeros(3), "invariant") for _ in range(2)]
    with pytest.raises(ValueError, match="no portals connect"):
        join(areas, [], (0, 1), 0)


# --- landmarks found twice ---


def placed(area, pose, *, kind="corner_concave", utility=1.0, material=(0, 1), fixed=False, **more):
    values = {"binds": ("x", "y", "theta"), "sigma": 0.01, "segments": np.zeros((0, 2, 2))}
    values |= {"inside": True} | more
    return Placed(
        area=area,
        kind=kind,
        pose=np.array(pose, dtype=float),
        material=np.array(material, dtype=float),
        utility=utility,
        fixed=fixed,
        **values,
    )


def test_of_a_landmark_in_two_areas_the_better_one_is_kept():
    same = [placed(0, [1, 1, 0], utility=3.0), placed(1, [1.1, 1, 1.5], utility=5.0)]
    assert duplicates(same, CONFIG) == {0}
    assert duplicates([same[0]._replace(fixed=True), same[1]], CONFIG) == {1}
    # What stands in the other area's free space is not this one's, however often it was seen.
    assert duplicates([same[0], same[1]._replace(inside=False)], CONFIG) == {1}


def test_which_points_lie_in_an_area():
    area = np.array([[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]], dtype=float)
    at = np.array([[0.5, 2.0], [2.0, 0.5], [2.0, 2.0], [-0.5, 0.5], [3.9, 0.9]])
    assert contains(area, at).tolist() == [True, True, False, False, True]
    assert not contains(area[:0], at).any()


def test_the_two_faces_of_a_wall_are_not_one():
    faces = [
        placed(0, [1, 1, 0], kind="door"),
        placed(1, [1, 1.15, 0], kind="door", material=(0, -1)),
    ]
    assert duplicates(faces, CONFIG) == set()


def test_a_wall_that_another_landmark_has_is_dropped():
    wall = placed(
        0, [0, 0, 0], kind="wall", binds=("y", "theta"), segments=np.array([[[0.0, 0], [2, 0]]])
    )
    corner = placed(1, [3, 0, 0], segments=np.array([[[0.4, 0.05], [3, 0.05]]]))
    assert duplicates([wall, corner], CONFIG) == {0}
    turned = corner._replace(segments=corner.segments[:, ::-1])
    assert duplicates([wall, turned], CONFIG) == set()
    aside = corner._replace(segments=corner.segments + np.array([0.0, 0.6]))
    assert duplicates([wall, aside], CONFIG) == set()


@pytest.mark.parametrize("seed", range(5))
def test_what_is_far_away_does_not_matter(seed):
    """The duplicates among all are those of each place by itself, 20 m from the next."""
    rng = np.random.default_rng(seed)
    kinds = {"corner_concave": ("x", "y", "theta"), "wall": ("y", "theta")}
    places = []
    for at in range(4):
        here = []
        for _ in range(12):
            kind = str(rng.choice(list(kinds)))
            start = np.array([20.0 * at, 0.0]) + rng.choice([0.0, 0.1, 0.5, 1.0], 2)
            along = np.array([rng.uniform(0.5, 2.0), 0.0])
            ends = np.array([[start, start + along]])
            here.append(
                placed(
                    int(rng.integers(3)), [*start, 0.0], kind=kind, binds=kinds[kind],
                    utility=float(rng.random()), segments=ends, fixed=bool(rng.random() < 0.1),
                )
            )  # fmt: skip
        places.append(here)
    found = duplicates([one for here in places for one in here], CONFIG)
    alone = {12 * i + j for i, here in enumerate(places) for j in duplicates(here, CONFIG)}
    assert found == alone
    assert 0 < len(found) < 48
