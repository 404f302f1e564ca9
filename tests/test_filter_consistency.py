"""Monte Carlo: whether the filter's covariances tell the truth (NEES of 1 a degree of freedom).

A robot drives circles among 20 landmarks that it sees whole. Each run draws the landmarks, the
noise of the wheels and that of the sightings from exactly the covariances that the filter is
given. The NEES is taken of the error in the filter's own coordinates.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from estimation_cases import error_of

from hiermap_cli.estimation.constraint import Rows, constrain, prepare
from hiermap_cli.estimation.stochastic_map import Motion, add_objects, initial_map, predict
from hiermap_cli.geometry import se2

LANDMARKS, REACH = 20, 6.0
INCREMENT = np.array([0.25, 0.0, 0.05])  # a circle of five metres
START = np.array([0.0, -5.0, 0.0])


class Run(NamedTuple):
    """NEES a degree of freedom: of the robot in each step, (n,); of the landmarks at the end."""

    robot: np.ndarray
    landmarks: float


def run(seed, steps, degrees, coordinates, update):
    rng = np.random.default_rng(seed)
    sigma = np.radians(degrees)
    spread_u, spread_z = np.array([0.02, 0.02, sigma]), np.array([0.1, 0.1, sigma])
    Q, R = np.diag(spread_u**2), np.diag(spread_z**2)
    landmarks = np.column_stack(
        (rng.uniform(-8.0, 8.0, (LANDMARKS, 2)), rng.uniform(-np.pi, np.pi, LANDMARKS))
    )
    truth, nees = START, np.zeros(steps)
    V = initial_map(START, np.zeros((3, 3)), np.zeros(0), np.zeros((0, 0)), coordinates)
    index: dict[int, int] = {}
    for k in range(steps):
        truth = se2.compose(se2.compose(truth, INCREMENT), se2.exp(spread_u * rng.normal(size=3)))
        V = predict(V, Motion(INCREMENT, Q, np.zeros((3, 0))))
        Z = se2.between(truth, landmarks)
        Z = se2.compose(Z, se2.exp(spread_z * rng.normal(size=Z.shape)))
        visible = np.flatnonzero(np.hypot(Z[:, 0], Z[:, 1]) < REACH).tolist()
        known = [i for i in visible if i in index]
        if known:
            V = seen_again(V, np.array([index[i] for i in known]), Z[known], R, update)
        new = [i for i in visible if i not in index]
        if new:
            V = add_objects(V, Z[new], np.tile(R, (len(new), 1, 1)))
            index.update(zip(new, range(len(index) + 1, V.objects + 1), strict=True))
        nees[k] = one(V, 0, truth)
    return Run(nees, float(np.mean([one(V, j, landmarks[i]) for i, j in index.items()])))


def seen_again(V, objects, Z, R, update):
    def measure(U):
        told = se2.between(U.robot, U.poses[objects])
        return se2.log(se2.compose(se2.invert(told), Z)).ravel()

    H = se2.adjoint(se2.invert(V.poses[objects])).reshape(-1, 3)
    rows = Rows(measure(V), np.repeat(objects, 3), H, np.zeros((len(H), 0)))
    return constrain(V, prepare(V, rows, np.kron(np.eye(len(Z)), R)), measure, update)[0]


def one(V, i, truth):
    e = error_of(V.coordinates, truth, V.poses[i])
    C = V.covariance[V.columns(i), V.columns(i)]
    return float(e @ np.linalg.solve(C, e)) / 3.0


@cache
def monte_carlo(runs, steps, degrees, coordinates, update):
    done = [run(seed, steps, degrees, coordinates, update) for seed in range(runs)]
    robot = np.array([r.robot for r in done])
    return robot, np.array([r.landmarks for r in done])


def honest(values):
    """Whether a mean over independent runs is 1 within four of its own deviations (the runs'
    spread tells it: the NEES of one run goes on from step to step)."""
    return abs(values.mean() - 1.0) < 4.0 * values.std() / np.sqrt(len(values))


@pytest.mark.parametrize("update", ["relocation_fusion", "ekf"])
def test_covariances_are_true_in_invariant_coordinates(update):
    """50 runs at 4 degrees of noise in heading, of wheels and of sightings."""
    robot, landmarks = monte_carlo(50, 100, 4.0, "invariant", update)
    assert 0.75 < robot.mean() < 1.25
    assert 0.75 < landmarks.mean() < 1.25
    assert 0.65 < robot[:, -20:].mean() < 1.35
    assert honest(robot.mean(axis=1))
    assert honest(landmarks)


def test_additive_coordinates_believe_themselves_too_much():
    """The same runs in (x, y, theta): false information, more and more of it."""
    robot, landmarks = monte_carlo(50, 100, 4.0, "additive", "ekf")
    invariant, of_landmarks = monte_carlo(50, 100, 4.0, "invariant", "ekf")
    assert robot[:, -20:].mean() > 1.25 * invariant[:, -20:].mean()
    assert landmarks.mean() > 1.3 * of_landmarks.mean()
    worse = robot[:, -20:].mean(axis=1) - invariant[:, -20:].mean(axis=1)
    assert worse.mean() > 3.0 * worse.std() / np.sqrt(len(worse))
    # Where headings are known to a degree there is nothing between them yet.
    little, _ = monte_carlo(50, 25, 1.0, "additive", "ekf")
    assert 0.7 < little.mean() < 1.3


@pytest.mark.slow
@pytest.mark.parametrize("update", ["relocation_fusion", "ekf"])
@pytest.mark.parametrize("degrees", [1.0, 2.0, 4.0])
def test_covariances_stay_true_over_many_rounds(update, degrees):
    robot, landmarks = monte_carlo(50, 500, degrees, "invariant", update)
    assert 0.85 < robot.mean() < 1.2
    assert 0.8 < landmarks.mean() < 1.25
    assert 0.7 < robot[:, -50:].mean() < 1.35
    assert honest(robot.mean(axis=1))


@pytest.mark.slow
def test_additive_coordinates_grow_worse_with_the_noise():
    means = [monte_carlo(50, 500, d, "additive", "ekf")[0].mean() for d in (1.0, 2.0, 4.0)]
    assert means[0] < means[1] < means[2]
    assert means[2] > 2.0
