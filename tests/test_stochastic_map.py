"""V and C(V): each step against its own nonlinear model by central differences on the manifold."""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import (
    COORDINATES,
    UPDATES,
    additive_covariance,
    derivative,
    error_of,
    gain_of,
    moved,
    random_covariance,
    random_map,
    random_pose,
    whole_jacobian,
)

from hiermap_cli.config import OdometryConfig
from hiermap_cli.estimation.constraint import Constraint, Rows, constrain, jacobian, prepare
from hiermap_cli.estimation.motion import motion
from hiermap_cli.estimation.stochastic_map import (
    StochasticMap,
    add_objects,
    clone_robot,
    corrected,
    initial_map,
    place_robot,
    predict,
    relative_covariance,
    remove_objects,
    seen_from_robot,
)
from hiermap_cli.geometry import se2

PARAMETERS = 4
ODOMETRY = OdometryConfig()


def errors(coordinates, poses, parameters, estimate):
    """All errors of a state (robot, parameters, objects) against an estimate of it."""
    parts = [error_of(coordinates, poses[0], estimate.poses[0]), parameters - estimate.parameters]
    parts += [
        error_of(coordinates, a, b) for a, b in zip(poses[1:], estimate.poses[1:], strict=True)
    ]
    return np.concatenate(parts)


def close(a, b):
    return np.allclose(a, b, rtol=1e-6, atol=1e-9 * max(1.0, np.abs(b).max()))


@pytest.fixture(params=COORDINATES)
def coordinates(request):
    return request.param


@pytest.fixture(params=range(3))
def rng(request):
    return np.random.default_rng(request.param)


# --- steps against their models ---


def test_predict(coordinates, rng):
    """Equation 1 with calibration: robot and parameters true by e, the noise by w."""
    V = random_map(rng, 2, coordinates)
    increment = np.array([0.3, -0.05, 0.4])
    step = motion(increment, V.parameters, ODOMETRY)
    after = predict(V, step)
    N = len(V.covariance)

    def truth(e):
        true = moved(V, e[:N])
        U = motion(increment, true.parameters, ODOMETRY).pose
        robot = se2.compose(se2.compose(true.robot, U), se2.exp(e[N:]))
        return errors(coordinates, np.vstack((robot, true.poses[1:])), true.parameters, after)

    J = derivative(truth, N + 3)
    Q = np.zeros((N + 3, N + 3))
    Q[:N, :N], Q[N:, N:] = V.covariance, step.covariance
    assert close(after.covariance, J @ Q @ J.T)
    assert after.robot == pytest.approx(se2.compose(V.robot, step.pose))
    assert np.array_equal(after.poses[1:], V.poses[1:])


def test_add_objects(coordinates, rng):
    """Equation 2: two objects seen from a robot whose laser is off by a parameter."""
    V = random_map(rng, 2, coordinates)
    seen = np.array([random_pose(rng), random_pose(rng)])
    C = np.array([random_covariance(rng, 3, 0.02), random_covariance(rng, 3, 0.02)])
    by_parameters = np.zeros((2, 3, PARAMETERS))
    by_parameters[:, 0, 3], by_parameters[:, 1, 3] = np.cos(seen[:, 2]), -np.sin(seen[:, 2])
    shift = np.zeros((2, 3))
    shift[:, 0] = V.parameters[3]
    after = add_objects(V, seen + shift, C, by_parameters)
    N = len(V.covariance)

    def truth(e):
        true = moved(V, e[:N])
        laser = np.array([true.parameters[3], 0.0, 0.0])
        new = [
            se2.compose(
                se2.compose(se2.compose(true.robot, laser), z),
                se2.exp(e[N + 3 * i : N + 3 * i + 3]),
            )
            for i, z in enumerate(seen)
        ]
        return errors(coordinates, np.vstack((true.poses, *new)), true.parameters, after)

    J = derivative(truth, N + 6)
    Q = np.zeros((N + 6, N + 6))
    Q[:N, :N], Q[N : N + 3, N : N + 3], Q[N + 3 :, N + 3 :] = V.covariance, C[0], C[1]
    assert close(after.covariance, J @ Q @ J.T)


def test_clone_robot(coordinates, rng):
    V = random_map(rng, 2, coordinates)
    after = clone_robot(V)
    assert np.array_equal(after.poses[-1], V.robot)
    assert close(after.covariance[-3:, :-3], V.covariance[:3])
    assert close(after.covariance[-3:, -3:], V.covariance[:3, :3])
    # What moves the one moves the other, whatever is learnt of it.
    row = np.zeros((1, 3))
    row[0] = 0.3, -1.0, 0.5
    told = gain_of(after.covariance, np.arange(3), row, np.array([[1e-3]]))
    learnt, _ = constrain(
        after,
        Constraint(np.array([0.2]), row, told),
        lambda _: np.array([0.2]),
        "ekf",
    )
    assert learnt.poses[-1] == pytest.approx(learnt.robot, abs=1e-12)


def test_relative_covariance(coordinates, rng):
    V = random_map(rng, 3, coordinates)
    for i, j in ((0, 2), (3, 0), (1, 2)):
        R_i_j = se2.between(V.poses[i], V.poses[j])

        def truth(e, i=i, j=j, R_i_j=R_i_j):
            true = moved(V, e)
            return se2.log(
                se2.compose(se2.between(true.poses[i], true.poses[j]), se2.invert(R_i_j))
            )

        J = derivative(truth, len(V.covariance))
        assert close(relative_covariance(V, i, j), J @ V.covariance @ J.T)


def test_place_robot(coordinates, rng):
    """The robot anew at an object; the parameters come from elsewhere."""
    V = random_map(rng, 3, coordinates)
    R_i_r = random_pose(rng)
    C, C_parameters = random_covariance(rng, 3, 0.03), random_covariance(rng, PARAMETERS, 0.02)
    parameters = rng.normal(size=PARAMETERS)
    after = place_robot(V, 2, R_i_r, C, parameters, C_parameters)
    N, m = len(V.covariance), PARAMETERS

    def truth(e):
        """e: of V, the parameters' in their place, then of R_i_r in the tangent at the object."""
        objects = moved(V, e[:N]).poses[1:]
        relative = se2.compose(se2.exp(e[N:]), R_i_r)
        robot = se2.compose(objects[1], relative)
        return errors(coordinates, np.vstack((robot, objects)), parameters + e[3 : 3 + m], after)

    J = derivative(truth, N + 3)
    Q = np.zeros((N + 3, N + 3))
    Q[:N, :N], Q[N:, N:] = V.covariance, C
    Q[3 : 3 + m], Q[:, 3 : 3 + m] = 0.0, 0.0
    Q[3 : 3 + m, 3 : 3 + m] = C_parameters
    assert close(after.covariance, J @ Q @ J.T)
    assert after.robot == pytest.approx(se2.compose(V.poses[2], R_i_r))
    assert np.array_equal(after.poses[1:], V.poses[1:])
    assert np.array_equal(after.parameters, parameters)


def test_seen_from_robot(coordinates, rng):
    V = random_map(rng, 4, coordinates)
    keep = np.array([3, 1])
    after = seen_from_robot(V, keep)

    def truth(e):
        true = moved(V, e)
        poses = np.vstack((np.zeros(3), se2.between(true.robot, true.poses[keep])))
        return errors(coordinates, poses, true.parameters, after)

    J = derivative(truth, len(V.covariance))
    assert close(after.covariance, J @ V.covariance @ J.T)
    assert not after.robot.any()
    assert not after.covariance[:3].any()


def test_objects_left_out_are_marginalised(coordinates, rng):
    V = random_map(rng, 4, coordinates)
    after = remove_objects(V, np.array([4, 2]))
    assert np.array_equal(after.poses, V.poses[[0, 4, 2]])
    columns = [*range(7), *range(7 + 9, 7 + 12), *range(7 + 3, 7 + 6)]
    assert np.array_equal(after.covariance, V.covariance[np.ix_(columns, columns)])


# --- coordinates ---


def test_additive_covariances_of_invariant_errors(rng):
    """By central differences, and nothing to do in additive coordinates."""
    V = random_map(rng, 2)
    J = derivative(lambda e: moved(V, np.concatenate((e[:3], np.zeros(4), e[3:]))).poses.ravel(), 9)
    keep = [*range(3), *range(7, 13)]
    P = V.covariance[np.ix_(keep, keep)]
    assert close(additive_covariance(V), J @ P @ J.T)
    for i in range(3):
        block = additive_covariance(V)[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        assert close(V.pose_covariance(i), block)
    additive = random_map(rng, 2, "additive")
    assert np.array_equal(additive_covariance(additive), additive.covariance[np.ix_(keep, keep)])


def test_errors_of_a_pose_by_its_own_frame(coordinates, rng):
    V = random_map(rng, 0, coordinates)
    D = derivative(lambda w: error_of(coordinates, se2.compose(V.robot, se2.exp(w)), V.robot), 3)
    assert close(V.error_D_tangent(V.robot), D)
    both = V.additive_D_error(V.robot) @ V.error_D_tangent(V.robot)
    assert close(both, derivative(lambda w: se2.compose(V.robot, se2.exp(w)), 3))
    assert close(
        V.invariant_D_error(V.robot),
        derivative(
            lambda e: error_of("invariant", moved(V, np.r_[e, np.zeros(4)]).robot, V.robot), 3
        ),
    )


def test_the_first_map_has_the_covariance_given(coordinates, rng):
    robot, C = random_pose(rng), random_covariance(rng, 3)
    V = initial_map(robot, C, np.zeros(2), 0.04 * np.eye(2), coordinates)
    assert close(V.pose_covariance(0), C)
    assert np.array_equal(V.covariance[3:, 3:], 0.04 * np.eye(2))
    assert V.objects == 0


def test_invariant_errors_do_not_depend_on_the_frame(rng):
    """The same map told from another frame gives the same correction, moved."""
    V = random_map(rng, 2)
    R_b_a = random_pose(rng)
    Ad = se2.adjoint(R_b_a)
    D = np.eye(len(V.covariance))
    for i in range(3):
        D[V.columns(i), V.columns(i)] = Ad
    W = StochasticMap(se2.compose(R_b_a, V.poses), V.parameters, D @ V.covariance @ D.T)
    z = se2.compose(se2.between(V.robot, V.poses[2]), np.array([0.05, -0.1, 0.08]))
    after, other = (seen(U, 2, z, update) for U, update in ((V, UPDATES[0]), (W, UPDATES[0])))
    assert other.poses == pytest.approx(se2.compose(R_b_a, after.poses), abs=1e-9)
    assert close(other.covariance, D @ after.covariance @ D.T)


def seen(V, i, z, update, R=None):
    """Object i seen whole at `z` from the robot."""

    def measure(U):
        return se2.log(se2.compose(se2.invert(se2.between(U.robot, U.poses[i])), z))

    H = se2.adjoint(se2.invert(V.poses[i]))
    rows = Rows(measure(V), np.full(3, i), H, np.zeros((3, len(V.parameters))))
    told = prepare(V, rows, np.diag([1e-4, 1e-4, 1e-4]) if R is None else R)
    return constrain(V, told, measure, update)[0]


# --- equation 3 ---


def test_rows_are_the_innovations_derivative(coordinates, rng):
    """H and its products: innovation and H of an object seen where it is predicted."""
    V = random_map(rng, 3, coordinates)
    z = se2.between(V.robot, V.poses[2])
    H = se2.adjoint(se2.invert(V.poses[2]))
    rows = Rows(np.zeros(3), np.full(3, 2), H, np.zeros((3, 4)))
    whole = whole_jacobian(V, rows)
    HP, HPH = jacobian(V, rows).times(V)
    assert close(HP, whole @ V.covariance)
    assert close(HPH, whole @ V.covariance @ whole.T)

    def innovation(e):
        true = moved(V, e)
        truly = se2.between(true.robot, true.poses[2])
        return se2.log(se2.compose(se2.invert(z), truly))

    assert close(whole, derivative(innovation, len(V.covariance)))


def test_what_is_not_seen_moves_by_its_correlation(coordinates, rng):
    """Conditioning: the rest of V moves by the regression on what was learnt."""
    V = random_map(rng, 3, coordinates, sigma=1e-3)
    for update in UPDATES:
        z = se2.compose(se2.between(V.robot, V.poses[1]), np.array([2e-3, -1e-3, 1e-3]))
        after = seen(V, 1, z, update, 1e-8 * np.eye(3))
        for i in (2, 3):
            shift = error_of(coordinates, after.poses[i], V.poses[i])
            assert np.abs(shift).max() > 1e-6
        assert np.abs(after.parameters - V.parameters).max() > 1e-6
        free = random_map(rng, 3, coordinates)
        P = free.covariance.copy()
        P[13:], P[:, 13:] = 0.0, 0.0
        P[13:, 13:] = 1e-4 * np.eye(3)
        alone = StochasticMap(free.poses, free.parameters, P, coordinates)
        z = se2.compose(se2.between(alone.robot, alone.poses[1]), np.array([0.02, -0.01, 0.01]))
        after = seen(alone, 1, z, update)
        assert after.poses[3] == pytest.approx(alone.poses[3], abs=1e-12)
        assert np.abs(after.poses[2] - alone.poses[2]).max() > 1e-6


def test_a_robot_far_off_among_landmarks_that_are_known():
    """Turned by 20 degrees: the invariant error is linear there, so that one step is exact; the
    additive one is not, and predicting anew at the relocated robot takes most of the rest off."""
    landmarks = np.array([[6.0, 1.0, 0.3], [-2.0, 5.0, 1.0], [1.0, -4.0, 2.0]])
    P = np.zeros((12, 12))
    P[:3, :3] = np.diag([0.1, 0.1, 0.3]) ** 2
    true = np.array([0.1, -0.05, 0.35])

    def measure(U):
        truly, told = se2.between(true, landmarks), se2.between(U.robot, U.poses[1:])
        return se2.log(se2.compose(se2.invert(told), truly)).ravel()

    H = np.concatenate([se2.adjoint(se2.invert(X)) for X in landmarks])
    off = {}
    for coordinates in COORDINATES:
        V = StochasticMap(np.vstack((np.zeros(3), landmarks)), np.zeros(0), P, coordinates)
        rows = Rows(measure(V), np.repeat([1, 2, 3], 3), H, np.zeros((9, 0)))
        told = prepare(V, rows, 1e-8 * np.eye(9))
        for update in UPDATES:
            after, _ = constrain(V, told, measure, update)
            off[coordinates, update] = np.abs(after.robot - true).max()
    assert off["invariant", "ekf"] < 1e-6
    assert off["invariant", "relocation_fusion"] < 1e-6
    assert off["additive", "ekf"] > 5e-3
    assert off["additive", "relocation_fusion"] < 0.3 * off["additive", "ekf"]


def test_a_step_leaves_its_input_alone(coordinates, rng):
    V = random_map(rng, 2, coordinates)
    before = V.poses.copy(), V.parameters.copy(), V.covariance.copy()
    predict(V, motion(np.array([0.1, 0.0, 0.1]), V.parameters, ODOMETRY))
    seen(V, 1, np.array([1.0, 0.0, 0.0]), "relocation_fusion")
    clone_robot(V)
    place_robot(V, 1, np.zeros(3), np.eye(3), np.zeros(4), np.eye(4))
    corrected(V, np.ones(len(V.covariance)), V.covariance)
    for old, new in zip(before, (V.poses, V.parameters, V.covariance), strict=True):
        assert np.array_equal(old, new)
