"""Conditioning a Gaussian: the Kalman filter, written out naively, gives the same."""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import gain_of, random_covariance
from hypothesis import given, settings
from hypothesis import strategies as st

from hiermap_cli.estimation.gaussian import condition, robot_correction, symmetrise


def naive(P, H, R, y):
    """The textbook's update by the full H and the inverse of S."""
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return K @ y, (np.eye(len(P)) - K @ H) @ P, y @ np.linalg.inv(S) @ y


def problem(seed, n=11, k=5, c=6):
    """P, columns, H over them, R, y."""
    rng = np.random.default_rng(seed)
    columns = rng.permutation(n)[:c]
    return (
        random_covariance(rng, n, 1.0),
        columns,
        rng.normal(size=(k, c)),
        random_covariance(rng, k, 0.5),
        rng.normal(size=k),
    )


def full(H_c, columns, n):
    H = np.zeros((len(H_c), n))
    np.add.at(H, (slice(None), columns), H_c)
    return H


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(4, 15),
    k=st.integers(1, 8),
)
def test_equals_the_naive_kalman_update(seed, n, k):
    P, columns, H_c, R, y = problem(seed, n, k, min(n, 6))
    delta, covariance, nis = condition(P, gain_of(P, columns, H_c, R), y)
    expected = naive(P, full(H_c, columns, n), R, y)
    assert np.allclose(delta, expected[0], rtol=0, atol=1e-9)
    assert np.allclose(covariance, expected[1], rtol=0, atol=1e-9)
    assert nis == pytest.approx(expected[2], rel=1e-9)


def test_the_covariance_stays_symmetric_to_the_bit_and_positive():
    P, columns, H_c, R, y = problem(3)
    for _ in range(200):
        _, P, _ = condition(P, gain_of(P, columns, H_c, R), y)
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > -1e-15


def test_the_relocation_step_is_the_robots_part_of_the_correction():
    P, columns, H_c, R, y = problem(4)
    told = gain_of(P, columns, H_c, R)
    assert robot_correction(told, y) == pytest.approx(condition(P, told, y).delta[:3], abs=1e-12)


def test_components_known_exactly_do_no_harm():
    """Zero rows of P stay zero, and the rest is as if they were not there."""
    P, columns, H_c, R, y = problem(6, n=9, k=4, c=9)
    exact, rest = np.array([1, 4, 5]), np.array([0, 2, 3, 6, 7, 8])
    P[exact], P[:, exact] = 0.0, 0.0
    H = full(H_c, columns, 9)
    delta, covariance, nis = condition(P, gain_of(P, columns, H_c, R), y)
    assert not delta[exact].any()
    assert not covariance[exact].any()
    without = naive(P[np.ix_(rest, rest)], H[:, rest], R, y)
    assert np.allclose(delta[rest], without[0], rtol=0, atol=1e-10)
    assert np.allclose(covariance[np.ix_(rest, rest)], without[1], rtol=0, atol=1e-10)
    assert nis == pytest.approx(without[2], rel=1e-9)


def test_fully_correlated_components_move_together():
    """A singular P: two components that are one stay one."""
    rng = np.random.default_rng(7)
    A = rng.normal(size=(5, 4))
    P = A @ random_covariance(rng, 4, 1.0) @ A.T
    P[4], P[:, 4] = P[0], P[:, 0]
    P[4, 4] = P[0, 0]
    delta, covariance, _ = condition(
        P, gain_of(P, np.arange(2), rng.normal(size=(2, 2)), 0.1 * np.eye(2)), np.array([1.0, -2.0])
    )
    assert delta[4] == pytest.approx(delta[0], abs=1e-12)
    assert covariance[4] == pytest.approx(covariance[0], abs=1e-12)


def test_two_measurements_at_once_or_one_after_the_other():
    P, columns, H_c, _, y = problem(8)
    R = np.diag([0.1, 0.2, 0.3, 0.4, 0.5])
    at_once = condition(P, gain_of(P, columns, H_c, R), y)
    delta, C, nis = np.zeros(len(P)), P, 0.0
    for rows in (slice(0, 2), slice(2, 5)):
        y_now = y[rows] - H_c[rows] @ delta[columns]
        step = condition(C, gain_of(C, columns, H_c[rows], R[rows, rows]), y_now)
        delta, C, nis = delta + step.delta, step.covariance, nis + step.nis
    assert np.allclose(delta, at_once.delta, rtol=0, atol=1e-10)
    assert np.allclose(C, at_once.covariance, rtol=0, atol=1e-10)
    assert nis == pytest.approx(at_once.nis, rel=1e-9)


def test_symmetric_part():
    assert np.array_equal(symmetrise(np.array([[1.0, 4.0], [2.0, 3.0]])), [[1.0, 3.0], [3.0, 3.0]])
