"""A pose in an area for every scan: once, in order, and with a covariance."""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import COORDINATES, random_covariance, random_pose
from hypothesis import given, settings
from hypothesis import strategies as st

from hiermap_cli.config import OdometryConfig
from hiermap_cli.estimation.motion import motion
from hiermap_cli.estimation.stochastic_map import Motion, StochasticMap
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.trail import Rows, Trail, invariant_covariance

NO_FAULTS = np.zeros(4)
ODOMETRY = OdometryConfig()


def at(pose, C=None, coordinates="invariant"):
    """V of a robot alone."""
    P = np.zeros((3, 3)) if C is None else C
    return StochasticMap(np.array(pose, dtype=float)[None], np.zeros(0), P, coordinates)


def carry(increment):
    return motion(increment, NO_FAULTS, ODOMETRY)


def path(n, seed=0):
    """Poses (n, 3) of a robot that wanders."""
    rng = np.random.default_rng(seed)
    steps = np.column_stack((0.05 + 0.02 * rng.random(n), np.zeros(n), 0.1 * rng.normal(size=n)))
    poses = np.zeros((n, 3))
    poses[0] = 1.0, -2.0, 0.5
    for i in range(1, n):
        poses[i] = se2.compose(poses[i - 1], se2.exp(steps[i]))
    return poses


def driven(truth, keys, correct=lambda pose: pose, C=None):
    """A trail along exact odometry, with the filter's estimate `correct(truth)` at key scans."""
    trail, last = Trail(), None
    for i, pose in enumerate(truth):
        if i not in keys:
            trail.between(i, se2.between(truth[last], pose))
            continue
        moved = None if last is None else carry(se2.between(truth[last], pose))
        trail.key(i, 0, at(correct(pose), C), moved)
        last = i
    trail.finish(carry)
    return trail


def positive(C):
    return np.allclose(C, C.T, rtol=0, atol=1e-15) and np.linalg.eigvalsh(C).min() >= -1e-15


@settings(max_examples=50, deadline=None)
@given(keys=st.sets(st.integers(1, 29)), seed=st.integers(0, 100))
def test_every_scan_has_its_pose_once_and_in_order(keys, seed):
    """Whichever scans the filter used: exact odometry is reproduced between them, and after."""
    truth = path(30, seed)
    trail = driven(truth, {0, *keys})
    assert trail.stamps_ns == list(range(30))
    assert trail.area == [0] * 30
    assert len(trail.covariances) == 30
    assert trail.key_at == sorted({0, *keys})
    assert np.abs(np.array(trail.poses) - truth).max() < 1e-12
    assert all(positive(C) for C in trail.covariances)


def test_key_scans_have_the_filters_own_estimate():
    rng = np.random.default_rng(1)
    C = random_covariance(rng, 3)
    trail = driven(path(9), {0, 4, 8}, C=C)
    for i in (0, 4, 8):
        assert np.array_equal(trail.covariances[i], C)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_covariances_are_invariant_whatever_the_coordinates(coordinates):
    rng = np.random.default_rng(2)
    V = at(random_pose(rng), random_covariance(rng, 3), coordinates)
    additive = se2.additive_D_invariant(V.robot)
    assert np.allclose(additive @ invariant_covariance(V) @ additive.T, V.pose_covariance(0))


def test_a_correction_is_shared_out_along_the_way():
    """Four equal steps straight on; the filter then finds that it is 8 cm to the left."""
    truth = np.column_stack((0.1 * np.arange(5), np.zeros(5), np.zeros(5)))
    trail = Trail()
    trail.key(0, 0, at(truth[0]))
    for i in (1, 2, 3):
        trail.between(i, truth[i])
    trail.key(4, 0, at([0.4, 0.08, 0.0]), carry(truth[4]))
    poses = np.array(trail.poses)
    assert poses[:, 0] == pytest.approx(truth[:, 0])
    assert poses[:, 1] == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08])


def test_nothing_jumps_at_a_key_scan():
    """With a correction at every key scan, the steps remain those of odometry and a share."""
    truth = path(41, seed=3)
    off = np.array([0.03, -0.02, 0.01])
    trail = driven(truth, set(range(0, 41, 5)), lambda pose: se2.compose(pose, off))
    told, true = (se2.between(p[:-1], p[1:]) for p in (np.array(trail.poses), truth))
    assert np.abs(told - true).max() < 0.5 * np.abs(off).max()
    assert np.array(trail.poses)[5:] == pytest.approx(se2.compose(truth, off)[5:], abs=0.01)


def test_calibrated_odometry_is_what_the_rest_is_measured_against():
    """The wheels read 10 % too little, and the filter knows: no correction remains, and the scans
    between lie where the true way was."""
    truth = np.column_stack((0.11 * np.arange(5), np.zeros(5), np.zeros(5)))
    read = truth / 1.1
    known = np.array([0.1, 0.0, 0.0, 0.0])
    trail = Trail()
    trail.key(0, 0, at(truth[0]))
    for i in (1, 2, 3):
        trail.between(i, read[i])
    trail.key(4, 0, at(truth[4]), motion(read[4], known, ODOMETRY))
    # At most a tenth of a step off: odometry as read, and what then remains is not shared anew.
    assert np.abs(np.array(trail.poses) - truth).max() < 0.1 * 0.11 * 3 + 1e-12


def test_between_two_poses_known_exactly_the_noise_is_that_of_a_bridge():
    """A random walk held at both ends: variance g (1 - g) of the whole, by sampling it."""
    steps, runs = 8, 40000
    rng = np.random.default_rng(4)
    walk = np.cumsum(rng.normal(size=(runs, steps)), axis=1)
    bridge = walk - walk[:, -1:] * (np.arange(1, steps + 1) / steps)
    sampled = bridge.var(axis=0)[:-1]
    truth = np.column_stack((0.1 * np.arange(steps + 1), np.zeros(steps + 1), np.zeros(steps + 1)))
    trail = Trail()
    trail.key(0, 0, at(truth[0]))
    for i in range(1, steps):
        trail.between(i, truth[i])
    Q = np.diag([float(steps), 0.0, 0.0])
    trail.key(steps, 0, at(truth[steps]), Motion(truth[steps], Q, np.zeros((3, 0))))
    told = [C[0, 0] for C in trail.covariances[1:-1]]
    assert told == pytest.approx(sampled, rel=0.05)


def test_a_scan_half_way_is_as_sure_as_both_ends_where_the_wheels_are_exact():
    C = random_covariance(np.random.default_rng(5), 3)
    trail = Trail()
    trail.key(0, 0, at(np.zeros(3), C))
    trail.between(1, np.array([0.1, 0.0, 0.0]))
    exact = Motion(np.array([0.2, 0.0, 0.0]), np.zeros((3, 3)), np.zeros((3, 0)))
    trail.key(2, 0, at([0.2, 0.0, 0.0], C), exact)
    assert np.allclose(trail.covariances[1], C, rtol=0, atol=1e-15)


def test_a_robot_that_stands_still_between_key_scans():
    """No progress at all: odometry has nothing to share out, and nothing divides by it."""
    trail = Trail()
    trail.key(0, 0, at(np.zeros(3), 1e-4 * np.eye(3)))
    trail.between(1, np.zeros(3))
    trail.key(2, 0, at([0.01, 0.0, 0.0], 1e-4 * np.eye(3)), carry(np.zeros(3)))
    assert np.isfinite(trail.poses).all()
    assert 0.0 <= trail.poses[1][0] <= 0.01
    assert all(positive(C) for C in trail.covariances)


def test_the_area_changes_where_the_robot_enters_another():
    """Scans after a crossing are in the new area, in its frame; those before stay in the old."""
    truth = path(13, seed=6)
    R_a_b = truth[6]
    trail = Trail()
    trail.key(0, 0, at(truth[0]))
    for i in range(1, 6):
        trail.between(i, se2.between(truth[0], truth[i]))
    trail.key(6, 0, at(truth[6]), carry(se2.between(truth[0], truth[6])))
    trail.enter(1, at(np.zeros(3)))
    for i in range(7, 11):
        trail.between(i, se2.between(truth[6], truth[i]))
    trail.key(11, 1, at(se2.between(R_a_b, truth[11])), carry(se2.between(truth[6], truth[11])))
    trail.between(12, se2.between(truth[11], truth[12]))
    trail.finish(carry)
    assert trail.stamps_ns == list(range(13))
    assert trail.area == [0] * 7 + [1] * 6
    poses = np.array(trail.poses)
    assert np.abs(poses[:7] - truth[:7]).max() < 1e-12
    assert np.abs(se2.compose(R_a_b, poses[7:]) - truth[7:]).max() < 1e-12


def test_the_tail_is_carried_by_odometry_and_grows_unsure_with_it():
    C = random_covariance(np.random.default_rng(7), 3, 0.01)
    trail = Trail()
    trail.key(0, 0, at([1.0, 2.0, 0.3], C))
    increments = np.array([[0.05, 0.0, 0.02], [0.1, 0.0, 0.04]])
    for i, increment in enumerate(increments):
        trail.between(1 + i, increment)
    trail.finish(carry)
    assert trail.poses[1:] == pytest.approx(
        se2.compose(np.array([1.0, 2.0, 0.3]), increments), abs=1e-15
    )
    for i, increment in enumerate(increments):
        Ad = se2.adjoint(trail.poses[1 + i])
        Q = carry(increment).covariance
        assert np.allclose(trail.covariances[1 + i], C + Ad @ Q @ Ad.T, rtol=0, atol=1e-15)
    trail.finish(carry)
    assert len(trail.stamps_ns) == 3  # the tail is written once


def test_last_stamp_is_of_the_last_scan_taken_in():
    trail = Trail()
    trail.key(10, 0, at(np.zeros(3)))
    assert trail.last_stamp_ns() == 10
    trail.between(20, np.array([0.01, 0.0, 0.0]))
    assert trail.last_stamp_ns() == 20


def test_the_last_increment_is_the_odometry_since_the_last_key_scan():
    trail = Trail()
    trail.key(10, 0, at(np.zeros(3)))
    assert trail.last_increment() is None
    trail.between(20, np.array([0.01, 0.0, 0.0]))
    trail.between(30, np.array([0.03, 0.0, 0.0]))
    assert trail.last_increment() == pytest.approx([0.03, 0.0, 0.0])
    trail.key(40, 0, at([0.05, 0.0, 0.0]), carry(np.array([0.05, 0.0, 0.0])))
    assert trail.last_increment() is None


def test_rows_are_a_list_of_arrays_in_one_block():
    rows = Rows(2, 2)
    given_ = [np.arange(4.0).reshape(2, 2) + i for i in range(5)]
    for row in given_:
        rows.append(row)
    assert len(rows) == 5
    assert np.array_equal(rows[1], given_[1])
    assert np.array_equal(rows[-1], given_[-1])
    assert np.array_equal(rows[1:3], given_[1:3])
    taken = np.array(rows)
    rows.append(given_[0])  # what was taken does not forbid it to grow
    assert np.array_equal(taken, given_)
    with pytest.raises(IndexError):
        rows[6]


def test_a_trail_that_is_asked_at_every_scan_is_the_same():
    """What is worked out for many stretches at one stroke does not depend on which these are."""
    truth, keys = path(400, seed=3), set(range(0, 400, 3))

    def off(pose):
        return se2.compose(pose, np.array([0.01, -0.02, 0.005]))

    whole = driven(truth, keys, off, 1e-4 * np.eye(3))
    asked, last = Trail(), None
    for i, pose in enumerate(truth):
        if i not in keys:
            asked.between(i, se2.between(truth[last], pose))
            continue
        moved = None if last is None else carry(se2.between(truth[last], pose))
        asked.key(i, 0, at(off(pose), 1e-4 * np.eye(3)), moved)
        assert len(asked.poses) == i + 1
        last = i
    asked.finish(carry)
    assert np.allclose(asked.poses, whole.poses, rtol=0, atol=1e-13)
    assert np.allclose(asked.covariances, whole.covariances, rtol=0, atol=1e-15)
    assert np.array_equal(asked.increments, whole.increments)
