"""Residuals of the refinement: their Jacobians, and what they do to outliers and to bias."""

from __future__ import annotations

import numpy as np
import pytest

from hiermap_cli.config import OdometryConfig
from hiermap_cli.estimation import motion as odometry_model
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.keyscans import KeyScans, ScanSegments
from hiermap_cli.mapping.refinement import problem
from hiermap_cli.mapping.refinement.odometry import motions
from hiermap_cli.mapping.refinement.problem import (
    Ends,
    Matched,
    Noise,
    State,
    Terms,
    Walls,
    layout,
    measured_noise,
    robust_weight,
    stepped,
)

PARAMETERS = np.array([0.02, -0.03, 0.01, 0.05])
FAR = 1e9  # a gate that no residual reaches


def scene(seed: int = 0, keys: int = 4, walls: int = 3) -> tuple[State, KeyScans, Noise, Matched]:
    """Key scans, walls and ends with residuals that are not zero."""
    rng = np.random.default_rng(seed)
    increments = rng.uniform([0.1, -0.02, -0.2], [0.3, 0.02, 0.2], (keys, 3))
    poses = np.zeros((keys, 3))
    for i in range(1, keys):
        poses[i] = se2.compose(poses[i - 1], increments[i] + rng.normal(0.0, 0.01, 3))
    W = rng.uniform([-3.0, -3.0, -3.0], [3.0, 3.0, 3.0], (walls, 3))
    n = keys * walls
    scan, wall = np.repeat(np.arange(keys), walls), np.tile(np.arange(walls), keys)
    seen = se2.between(poses[scan], W[wall]) + rng.normal(0.0, 0.02, (n, 3))
    along = np.column_stack((np.cos(seen[:, 2]), np.sin(seen[:, 2])))
    segments = ScanSegments(
        scan=scan,
        centre=seen[:, :2] + 0.3 * along,
        theta=seen[:, 2],
        var_theta=np.full(n, 1e-4),
        var_y=np.full(n, 1e-4),
        ends=np.stack((seen[:, :2] - 0.5 * along, seen[:, :2] + along), axis=1),
        end_kind=np.ones((n, 2), dtype=np.int64),
        end_sigma=np.full((n, 2), 0.01),
        length=np.full(n, 1.5),
        wall=wall,
    )
    keyscans = KeyScans(
        stamps_ns=np.arange(keys) * 10**9,
        area=np.zeros(keys, dtype=np.int64),
        increments=increments,
        trusted=np.ones(keys, dtype=bool),
        segments=segments,
    )
    state = State(
        poses,
        PARAMETERS,
        Walls(W, np.full(walls, -0.5), np.full(walls, 1.0)),
        Ends(np.arange(walls), np.ones(walls, dtype=np.int64), rng.normal(1.0, 0.05, walls)),
    )
    every = np.arange(n)
    matched = Matched(every, wall, every, np.ones(n, dtype=np.int64), wall)
    noise = Noise(np.full(n, 1e-3), np.full(n, 1e-3), np.full((n, 2), 1e-3))
    return state, keyscans, noise, matched


def terms_of(kind: str, state, keyscans, noise, matched):
    if kind == "walls":
        return problem.wall_terms(state, keyscans.segments, noise, matched, FAR)
    if kind == "ends":
        return problem.end_terms(state, keyscans.segments, noise, matched, FAR, 0.0)
    return problem.odometry_terms(state, keyscans, OdometryConfig(), 1.0, FAR)


@pytest.mark.parametrize("kind", ["walls", "ends", "odometry"])
@pytest.mark.parametrize("seed", range(4))
def test_jacobians_meet_central_differences(kind, seed):
    state, keyscans, noise, matched = scene(seed)
    terms = terms_of(kind, state, keyscans, noise, matched)
    size, h = layout(state).size, 1e-6
    written = np.zeros((*terms.e.shape, size))
    for k in range(terms.columns.shape[1]):
        np.add.at(written, (np.arange(len(terms.e))[:, None],
                            np.arange(terms.e.shape[1])[None], terms.columns[:, k, None]),
                  terms.J[:, :, k])  # fmt: skip
    for j in range(size):
        x = np.zeros(size)
        x[j] = h
        ahead = terms_of(kind, stepped(state, x), keyscans, noise, matched).e
        back = terms_of(kind, stepped(state, -x), keyscans, noise, matched).e
        expected = (ahead - back) / (2.0 * h)
        # Of the odometry's residual the logarithm is taken as straight, which is as wrong as the
        # residual is large; where it is zero the next test holds the Jacobian to be exact.
        near = 2.0 * np.abs(terms.e).max() if kind == "odometry" else 1e-7
        np.testing.assert_allclose(written[:, :, j], expected, atol=near)


def test_odometry_jacobian_is_exact_where_the_residual_is_zero():
    state, keyscans, noise, matched = scene(1)
    M = motions(keyscans.increments, PARAMETERS, OdometryConfig()).pose
    poses = state.poses.copy()
    for i in range(1, len(poses)):
        poses[i] = se2.compose(poses[i - 1], M[i])
    state = state._replace(poses=poses)
    terms = terms_of("odometry", state, keyscans, noise, matched)
    np.testing.assert_allclose(terms.e, 0.0, atol=1e-12)
    h, size = 1e-6, layout(state).size
    for j in range(size):
        x = np.zeros(size)
        x[j] = h
        ahead = terms_of("odometry", stepped(state, x), keyscans, noise, matched).e
        back = terms_of("odometry", stepped(state, -x), keyscans, noise, matched).e
        written = np.where((terms.columns == j)[:, None, :], terms.J, 0.0).sum(axis=2)
        np.testing.assert_allclose(written, (ahead - back) / (2.0 * h), atol=1e-7)


def test_many_motions_are_each_the_filters():
    rng = np.random.default_rng(2)
    increments = rng.normal(0.0, 0.3, (20, 3))
    config = OdometryConfig()
    many = motions(increments, PARAMETERS, config)
    for i, increment in enumerate(increments):
        one = odometry_model.motion(increment, PARAMETERS, config)
        np.testing.assert_allclose(many.pose[i], one.pose, atol=1e-12)
        np.testing.assert_allclose(many.covariance[i], one.covariance, atol=1e-15)
        np.testing.assert_allclose(many.by_parameters[i], one.by_parameters,
                                   atol=1e-12)  # fmt: skip


def test_gaussian_residuals_keep_their_weight_and_outliers_lose_theirs():
    weight = robust_weight(np.array([0.0, 5.0, 9.0, 90.0]), 9.0)
    np.testing.assert_allclose(weight, [1.0, 1.0, 1.0, 0.1])


def test_views_of_an_end_from_one_side_cannot_make_it_surer_than_their_common_error():
    state, keyscans, noise, matched = scene(0, keys=100, walls=1)
    bias = 0.2
    terms = problem.end_terms(state, keyscans.segments, noise, matched, FAR, bias)
    total = terms.information.sum()
    sides = 2
    assert total < sides / (bias**2 * 1e-3)
    alone = problem.end_terms(state, keyscans.segments, noise, matched, FAR, 0.0)
    np.testing.assert_allclose(alone.information.sum(), 100 / 1e-3)


def test_failed_odometry_says_little_and_nothing_of_the_calibration():
    state, keyscans, _, _ = scene(3)
    trusted = keyscans.trusted.copy()
    trusted[2] = False
    terms = problem.odometry_terms(
        state, keyscans._replace(trusted=trusted), OdometryConfig(), 1.0, FAR
    )
    sure = problem.odometry_terms(state, keyscans, OdometryConfig(), 1.0, FAR)
    assert np.trace(terms.information[1]) < 0.01 * np.trace(sure.information[1])
    np.testing.assert_array_equal(terms.J[1, :, 6:9], 0.0)


def test_noise_of_the_readings_bends_no_calibration():
    """True steps and noisy readings of them, most of them straight ahead: the noise of a heading
    that does not turn is no rotation whose scale could be told."""
    rng, n, config = np.random.default_rng(4), 3000, OdometryConfig()
    told = np.column_stack((np.full(n, 0.2), np.zeros(n), np.where(np.arange(n) % 5, 0.0, 0.2)))
    M = motions(told, PARAMETERS, config)
    poses = np.zeros((n + 1, 3))
    for i in range(n):
        poses[i + 1] = se2.compose(poses[i], M.pose[i])
    noise = np.linalg.cholesky(M.covariance) @ rng.standard_normal((n, 3, 1))
    read = se2.compose(told, se2.exp(noise[..., 0]))
    state, keyscans, _, _ = scene()
    keyscans = keyscans._replace(
        increments=np.vstack((np.zeros(3), read)), trusted=np.ones(n + 1, dtype=bool)
    )
    parameters = np.zeros(4)
    for _ in range(8):
        state = state._replace(poses=poses, parameters=parameters)
        terms = problem.odometry_terms(state, keyscans, config, 1.0, FAR)
        J = terms.J[:, :, 6:]
        JW = np.einsum("nij,nik->njk", J, terms.information)
        H = np.einsum("njk,nkl->jl", JW, J)
        parameters = parameters - np.linalg.solve(H, np.einsum("njk,nk->j", JW, terms.e))
    sigma = np.sqrt(np.diag(np.linalg.inv(H)))
    assert (np.abs(parameters - PARAMETERS) < 3.0 * sigma).all()
    assert (sigma < 0.02).all()


def test_noise_is_what_the_residuals_say():
    """Residuals drawn with other variances than were taken: each kind gets its own factor."""
    rng = np.random.default_rng(3)
    n = 6000
    noise = Noise(np.full(n, 1e-4), np.full(n, 4e-4), np.full((n, 2), 9e-4))
    rows = np.arange(n)
    e = rng.normal(size=(n, 2)) * np.sqrt([0.5e-4, 8e-4])
    one = np.eye(2)[None].repeat(n, axis=0)
    walls = Terms(rows, rows[:, None], one, e, one, np.zeros(n), rows[:, None])
    of_ends = rng.normal(size=(n, 1)) * 0.03
    sides = np.column_stack((rows, np.zeros(n, dtype=np.int64)))
    ends = Terms(rows, rows[:, None], one, of_ends, one, np.zeros(n), sides)
    none = Terms(rows[:0], rows[:0, None], one[:0], e[:0], one[:0], np.zeros(0), rows[:0, None])
    found = measured_noise(noise, (none, walls, ends), 0, 1e9)
    assert found.across[0] == pytest.approx(0.5e-4, rel=0.06)
    assert found.heading[0] == pytest.approx(8e-4, rel=0.06)
    assert found.ends[0, 0] == pytest.approx(9e-4, rel=0.06)
    fitted = measured_noise(noise, (none, walls, ends), 3 * n // 2, 1e9)
    assert fitted.across[0] == pytest.approx(2.0 * found.across[0])
    e[:60] = 1.0
    robust = measured_noise(noise, (none, walls._replace(e=e), ends), 0, 9.2)
    assert robust.across[0] == pytest.approx(0.5e-4, rel=0.2)
