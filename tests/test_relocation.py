"""Where the robot is, by the scan alone: found among the walls, or not claimed."""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import (
    COORDINATES,
    derivative,
    error_of,
    random_map,
    random_pose,
    view_from,
    walls_area,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from hiermap_cli.config import RelocationConfig
from hiermap_cli.estimation.stochastic_map import StochasticMap
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.association.relocation import (
    area_lines,
    explained_length,
    relocate,
    robot_found,
    search_window,
    widened,
)

CONFIG = RelocationConfig()

# A room with a niche and a slanted wall: no two places in it look alike.
WALLS = np.array(
    [
        [0.0, -2.0, 0.0],
        [4.0, -0.5, 0.5 * np.pi],
        [2.5, 1.8, 0.8 * np.pi],
        [-1.0, 2.6, np.pi],
        [-4.0, 0.3, -0.5 * np.pi],
        [-2.4, -1.2, 0.5 * np.pi],
    ]
)
HALF = [4.0, 1.5, 1.6, 1.9, 2.3, 0.8]


def odd_room(robot, seen=5, coordinates="invariant"):
    P = 1e-6 * np.eye(3 + 4 + 3 * len(WALLS))
    V = StochasticMap(np.vstack((robot, WALLS)), np.zeros(4), P, coordinates)
    return walls_area(V, HALF, seen=seen)


def scan_at(pose, walls=range(6)):
    area = odd_room(pose)
    return view_from(area, [(w, -HALF[w] + 0.1, HALF[w] - 0.1) for w in walls])


def off_by(pose, dx=0.0, dy=0.0, dtheta=0.0):
    x, y, theta = pose
    return np.array([x + dx, y + dy, float(se2.wrap(theta + dtheta))])


@settings(max_examples=40, deadline=None)
@given(
    x=st.floats(-1.5, 1.5), y=st.floats(-1.0, 1.0), theta=st.floats(-3.1, 3.1),
    off=st.floats(0.0, 0.9), way=st.floats(-3.1, 3.1), turned=st.floats(-1.5, 1.5),
)  # fmt: skip
def test_a_robot_that_believes_itself_elsewhere_is_found(x, y, theta, off, way, turned):
    """Up to 90 cm and 85 degrees off, in a room that looks like itself from nowhere else."""
    truth = np.array([x, y, theta])
    believed = off_by(truth, off * np.cos(way), off * np.sin(way), turned)
    found = relocate(odd_room(believed), scan_at(truth), CONFIG, suspect=True)
    assert found is not None
    assert found.pose[:2] == pytest.approx(truth[:2], abs=0.02)
    assert se2.wrap(found.pose[2] - theta) == pytest.approx(0.0, abs=0.01)
    assert found.explained == pytest.approx(found.total, rel=0.05)
    assert found.second <= CONFIG.second * found.explained


def test_a_scan_from_elsewhere_is_not_found():
    other = odd_room(np.zeros(3))
    strange = np.array([[0.0, -1.0, 0.3], [1.5, 0.2, 1.2], [0.4, 1.2, 2.6], [-1.0, 0.0, -1.9]])
    P = 1e-6 * np.eye(7 + 12)
    there = walls_area(StochasticMap(np.vstack((np.zeros(3), strange)), np.zeros(4), P), [0.7] * 4)
    view = view_from(there, [(w, -0.7, 0.7) for w in range(4)])
    assert relocate(other, view, CONFIG, suspect=True) is None


def test_two_places_that_explain_as_much_are_not_chosen_between():
    """A corridor with two niches that look alike, 1.2 m apart."""
    niches = [[x, 0.0, 0.5 * np.pi] for x in (-0.6, 0.6)] + [[x, 1.0, np.pi] for x in (-1.0, 0.2)]
    walls = np.array([[0.0, -1.0, 0.0], *niches])
    P = 1e-6 * np.eye(7 + 15)
    area = walls_area(
        StochasticMap(np.vstack(([0.0, 0.0, 0.0], walls)), np.zeros(4), P),
        [6.0, 0.5, 0.5, 0.4, 0.4],
    )
    seeing = area._replace(V=area.V._replace(poses=np.vstack(([-0.6, -0.3, 0.0], walls))))
    view = view_from(seeing, [(0, -1.6, 0.4), (1, -0.5, 0.5), (3, -0.4, 0.4)])
    assert relocate(area, view, CONFIG, suspect=True) is None
    # With what tells the niches apart in sight there is no doubt.
    both = view_from(seeing, [(0, -1.6, 0.4), (1, -0.5, 0.5), (2, -0.5, 0.5), (3, -0.4, 0.4)])
    found = relocate(area, both, RelocationConfig(min_explained=1.0), suspect=True)
    assert found is not None
    assert found.pose == pytest.approx([-0.6, -0.3, 0.0], abs=0.03)


def test_parallel_walls_give_no_place():
    walls = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, np.pi]])
    P = 1e-6 * np.eye(7 + 6)
    area = walls_area(StochasticMap(np.vstack((np.zeros(3), walls)), np.zeros(4), P), [5.0, 5.0])
    view = view_from(area, [(0, -3.0, 3.0), (1, -3.0, 3.0)])
    assert relocate(area, view, CONFIG, suspect=True) is None


def test_too_little_to_go_by():
    pose = np.array([0.2, 0.1, 0.3])
    area = odd_room(pose)
    assert relocate(area, scan_at(pose, [0]), CONFIG, suspect=True) is None
    young = odd_room(pose, seen=CONFIG.least_seen - 1)
    assert relocate(young, scan_at(pose), CONFIG, suspect=True) is None
    short = view_from(area, [(0, 0.0, 0.4), (1, 0.0, 0.4), (2, 0.0, 0.4)])
    assert short.length.sum() < CONFIG.min_explained
    assert relocate(area, short, CONFIG, suspect=True) is None


def test_beyond_the_window_nothing_is_searched():
    truth = np.array([-1.0, 0.5, 0.2])
    far = off_by(truth, dx=CONFIG.max_distance + 0.5)
    assert relocate(odd_room(far), scan_at(truth), CONFIG, suspect=True) is None
    turned = off_by(truth, dtheta=CONFIG.max_turn + 0.3)
    assert relocate(odd_room(turned), scan_at(truth), CONFIG, suspect=True) is None


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_the_window_is_what_the_prediction_leaves_open(coordinates):
    c = CONFIG

    def window(sigma, sigma_theta, *, suspect=False):
        pose = np.array([3.0, -2.0, 0.5])
        J = np.linalg.inv(odd_room(pose, coordinates=coordinates).V.additive_D_error(pose))
        area = odd_room(pose, coordinates=coordinates)
        C = np.diag([sigma**2, sigma**2, sigma_theta**2])
        area.V.covariance[:3, :3] = J @ C @ J.T
        return search_window(area.V, c, suspect=suspect)

    assert window(1e-4, 1e-4) == (c.min_distance, c.min_turn)
    distance, turn = window(0.2, 0.1)
    assert distance == pytest.approx(c.window_sigmas * 0.2 * np.sqrt(2.0))
    assert turn == pytest.approx(c.window_sigmas * 0.1)
    assert window(5.0, 3.0) == (c.max_distance, c.max_turn)
    assert window(1e-4, 1e-4, suspect=True) == (c.max_distance, c.max_turn)


def test_lines_of_an_area():
    """Points of a wall lie at its offset along its normal, within its extent along its heading."""
    area = odd_room(np.zeros(3))
    lines = area_lines(area, 3)
    for w, X in enumerate(WALLS):
        heading = np.array([np.cos(X[2]), np.sin(X[2])])
        for s in (-HALF[w], HALF[w]):
            point = X[:2] + s * heading
            assert lines.normal[w] @ point == pytest.approx(lines.offset[w])
            assert lines.lo[w] - 1e-9 <= heading @ point <= lines.hi[w] + 1e-9
        assert lines.hi[w] - lines.lo[w] == pytest.approx(2.0 * HALF[w])
    assert len(area_lines(area, 6).theta) == 0


def test_explained_length():
    truth = np.array([0.4, -0.2, 0.6])
    view = scan_at(truth)
    lines = area_lines(odd_room(truth), 3)
    near = off_by(truth, dx=0.02, dtheta=0.01)
    poses = np.array([truth, near, off_by(truth, 0.4, 0.4), off_by(truth, dtheta=np.pi)])
    told = explained_length(lines, view, poses, CONFIG)
    assert told[0] == pytest.approx(view.length.sum())
    assert told[1] == pytest.approx(view.length.sum(), rel=0.05)
    assert told[2] < 0.5 * told[0]
    assert told[3] < 0.5 * told[0]


# --- hypotheses become predictions ---


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_a_robot_found_has_nothing_in_common_with_the_map(coordinates):
    rng = np.random.default_rng(2)
    V = random_map(rng, 2, coordinates)
    pose = random_pose(rng)
    after = robot_found(V, pose, CONFIG)
    assert np.array_equal(after.robot, pose)
    assert not after.covariance[:3, 3:].any()
    assert np.array_equal(after.covariance[3:, 3:], V.covariance[3:, 3:])
    D = derivative(lambda w: error_of(coordinates, se2.compose(pose, se2.exp(w)), pose), 3)
    C = np.diag(np.square([CONFIG.sigma, CONFIG.sigma, CONFIG.sigma_angle]))
    assert np.allclose(after.covariance[:3, :3], D @ C @ D.T, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_room_for_a_slip_is_in_the_robots_own_frame(coordinates):
    V = random_map(np.random.default_rng(3), 2, coordinates)
    after = widened(V, CONFIG)
    assert np.array_equal(after.poses, V.poses)
    D = derivative(lambda w: error_of(coordinates, se2.compose(V.robot, se2.exp(w)), V.robot), 3)
    C = np.diag(np.square([CONFIG.slip, CONFIG.slip, CONFIG.slip_angle]))
    added = after.covariance - V.covariance
    assert np.allclose(added[:3, :3], D @ C @ D.T, rtol=1e-6, atol=1e-9)
    assert np.array_equal(after.covariance[3:], V.covariance[3:])
