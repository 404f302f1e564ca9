"""The odometry model: calibration, noise that does not mind how the way is cut, failures."""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import COORDINATES, derivative, random_map
from hypothesis import given, settings
from hypothesis import strategies as st

from hiermap_cli.config import OdometryConfig
from hiermap_cli.estimation.motion import (
    CURVATURE,
    LASER_X,
    PARAMETERS,
    ROTATION_SCALE,
    SCALE,
    distrusted,
    motion,
    prior_covariance,
)
from hiermap_cli.estimation.stochastic_map import predict
from hiermap_cli.geometry import se2

CONFIG = OdometryConfig()
NONE = np.zeros(PARAMETERS)

increments = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.1, 0.1), st.floats(-0.6, 0.6)).map(
    np.array
)
calibrations = st.lists(st.floats(-0.15, 0.15), min_size=PARAMETERS, max_size=PARAMETERS).map(
    np.array
)


@given(increment=increments)
def test_without_faults_the_motion_is_the_increment(increment):
    assert motion(increment, NONE, CONFIG).pose == pytest.approx(increment, abs=1e-15)


@settings(max_examples=60, deadline=None)
@given(increment=increments, parameters=calibrations)
def test_by_parameters_meets_central_differences(increment, parameters):
    """The error is in the frame after the motion: `X(c + e) = X(c) exp(J e)`."""
    step = motion(increment, parameters, CONFIG)

    def error(e):
        truly = motion(increment, parameters + e, CONFIG).pose
        return se2.log(se2.compose(se2.invert(step.pose), truly))

    assert np.allclose(step.by_parameters, derivative(error, PARAMETERS), rtol=0, atol=1e-8)


def parameters_of(**values):
    names = {"scale": SCALE, "rotation_scale": ROTATION_SCALE, "curvature": CURVATURE}
    out = np.zeros(PARAMETERS)
    for name, value in values.items():
        out[names[name]] = value
    return out


def test_scale_lengthens_the_way_and_leaves_the_angle():
    step = motion(np.array([0.2, 0.0, 0.1]), parameters_of(scale=0.1), CONFIG)
    assert step.pose == pytest.approx([0.22, 0.0, 0.1])


def test_rotation_scale_turns_more():
    step = motion(np.array([0.0, 0.0, 0.4]), parameters_of(rotation_scale=-0.05), CONFIG)
    assert step.pose == pytest.approx([0.0, 0.0, 0.38])


def test_curvature_bends_the_way_and_backing_up_unbends_it():
    bent = parameters_of(curvature=0.1)
    there = motion(np.array([0.5, 0.0, 0.0]), bent, CONFIG).pose
    assert there[2] == pytest.approx(0.05)
    assert np.arctan2(there[1], there[0]) == pytest.approx(0.025)  # the chord, by half of it
    back = motion(np.array([-0.5, 0.0, 0.0]), bent, CONFIG).pose
    assert se2.compose(there, back) == pytest.approx(np.zeros(3), abs=1e-12)


def test_calibrated_steps_add_up_to_the_calibrated_whole():
    """Arcs in small steps against the formulas over the whole of the way."""
    parameters = parameters_of(scale=0.04, rotation_scale=-0.03, curvature=0.05)
    n = 200
    piece = se2.exp(np.array([1.2, 0.0, 0.8]) / n)
    pose = np.zeros(3)
    for _ in range(n):
        pose = se2.compose(pose, motion(piece, parameters, CONFIG).pose)
    turn = 0.97 * 0.8 + 0.05 * 1.2
    assert pose == pytest.approx(se2.exp(np.array([1.04 * 1.2, 0.0, turn])), abs=1e-4)


@pytest.mark.parametrize("coordinates", COORDINATES)
@pytest.mark.parametrize("pieces", [2, 7])
@pytest.mark.parametrize(
    "way", [(0.8, 0.0, 0.0), (-0.8, 0.0, 0.0), (0.0, 0.0, 1.2), (0.0, 0.0, -1.2)]
)
def test_noise_is_the_same_however_the_way_is_cut(coordinates, pieces, way):
    """Straight on, straight back, on the spot: to the digit, with all cross-covariances."""
    V = random_map(np.random.default_rng(1), 2, coordinates)
    V.parameters[:] = 0.0
    whole = predict(V, motion(np.array(way), NONE, CONFIG))
    cut = V
    for _ in range(pieces):
        cut = predict(cut, motion(np.array(way) / pieces, NONE, CONFIG))
    assert cut.robot == pytest.approx(whole.robot, abs=1e-12)
    assert np.allclose(cut.covariance, whole.covariance, rtol=0, atol=1e-12)


@pytest.mark.parametrize("turn", [0.5, -0.5])
def test_on_an_arc_cutting_changes_next_to_nothing(turn):
    """The chord is shorter than the arc by turn^2 / 24, and the noise with it."""
    V = random_map(np.random.default_rng(2), 0, sigma=1e-6)
    V.parameters[:] = 0.0
    arc, pieces = np.array([0.5, 0.0, turn]), 10
    whole = predict(V, motion(se2.exp(arc), NONE, CONFIG))
    cut = V
    for _ in range(pieces):
        cut = predict(cut, motion(se2.exp(arc / pieces), NONE, CONFIG))
    C, D = whole.pose_covariance(0), cut.pose_covariance(0)
    sigma = np.sqrt(np.diagonal(C))
    assert np.abs(C - D).max() < 0.1 * np.abs(C).max()
    assert np.sqrt(np.diagonal(D)) == pytest.approx(sigma, rel=0.03)


def test_the_noise_of_a_straight_way_is_that_of_a_random_walk():
    """Many small steps, each with noise of its own, sampled."""
    rng = np.random.default_rng(5)
    steps, runs = 40, 20000
    d = 1.0 / steps
    poses = np.zeros((runs, 3))
    for _ in range(steps):
        w = rng.normal(size=(runs, 3)) * np.sqrt(d) * [
            CONFIG.sigma_xy_per_sqrt_m, CONFIG.sigma_xy_per_sqrt_m, CONFIG.sigma_theta_per_sqrt_m
        ]  # fmt: skip
        poses = se2.compose(se2.compose(poses, np.array([d, 0.0, 0.0])), se2.exp(w))
    truly = np.array([1.0, 0.0, 0.0])
    errors = se2.log(se2.compose(se2.invert(truly), poses))
    C = errors.T @ errors / runs
    Q = motion(truly, NONE, CONFIG).covariance
    scale = np.sqrt(np.outer(np.diagonal(Q), np.diagonal(Q)))
    # The walk has its steps' noise at their ends: a lever shorter by one in 40.
    assert np.abs((C - Q) / scale).max() < 0.05


@settings(max_examples=50, deadline=None)
@given(increment=increments)
def test_the_noise_is_a_covariance_and_grows_with_the_way(increment):
    Q = motion(increment, NONE, CONFIG).covariance
    assert np.array_equal(Q, Q.T)
    assert np.linalg.eigvalsh(Q).min() >= -1e-18
    more = motion(1.5 * increment, NONE, CONFIG).covariance
    assert (np.diagonal(more) >= np.diagonal(Q)).all()


def test_no_motion_has_no_noise():
    step = motion(np.zeros(3), NONE, CONFIG)
    assert not step.covariance.any()
    assert not step.by_parameters.any()


@given(increment=increments, lever=st.floats(-0.3, 0.3))
def test_the_robot_turns_about_a_point_behind_it(increment, lever):
    """The point about which odometry turns, `lever` behind the robot, makes the increment."""
    parameters = np.array([0.0, 0.0, 0.0, lever])
    step = motion(increment, parameters, CONFIG)
    L = np.array([lever, 0.0, 0.0])
    made = se2.compose(se2.compose(L, step.pose), se2.invert(L))
    assert made == pytest.approx(increment, abs=1e-12)
    behind = motion(increment, NONE, CONFIG).covariance
    Ad = se2.adjoint(se2.invert(L))
    assert np.allclose(step.covariance, Ad @ behind @ Ad.T, rtol=0, atol=1e-15)


def test_driving_straight_says_nothing_of_the_lasers_place():
    straight = motion(np.array([0.3, 0.0, 0.0]), NONE, CONFIG)
    assert not straight.by_parameters[:, LASER_X].any()
    turning = motion(np.array([0.0, 0.0, 0.5]), NONE, CONFIG)
    assert turning.by_parameters[:, LASER_X] == pytest.approx([1.0 - np.cos(0.5), np.sin(0.5), 0.0])


def test_the_prior_has_the_configurations_sigmas():
    C = prior_covariance(CONFIG)
    expected = [
        CONFIG.prior_scale,
        CONFIG.prior_rotation_scale,
        CONFIG.prior_curvature,
        CONFIG.prior_laser_x,
    ]
    assert np.sqrt(np.diagonal(C)) == pytest.approx(expected)
    assert np.count_nonzero(C) == PARAMETERS


def test_what_cannot_be_true_says_little_and_nothing_of_the_calibration():
    step = motion(np.array([3.0, 0.0, 1.0]), NONE, CONFIG)
    doubted = distrusted(step, CONFIG)
    assert np.array_equal(doubted.pose, step.pose)
    assert not doubted.by_parameters.any()
    added = doubted.covariance - step.covariance
    assert np.sqrt(np.diagonal(added)) == pytest.approx(
        [CONFIG.fault_sigma_xy, CONFIG.fault_sigma_xy, CONFIG.fault_sigma_theta]
    )
    V = random_map(np.random.default_rng(3), 1)
    after = predict(V, doubted)
    assert np.array_equal(after.covariance[3:, 3:], V.covariance[3:, 3:])
