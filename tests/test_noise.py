"""How large the noise is, from the filter's own innovations."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
from estimation_cases import gain_of, random_covariance
from world_cases import TWO_ROOMS, world_of

from hiermap_cli.config import Config, NoiseConfig
from hiermap_cli.estimation.gaussian import condition
from hiermap_cli.estimation.noise import (
    WORST,
    NoiseScale,
    Surprise,
    adapted,
    residual_factor,
    surprise,
)
from hiermap_cli.mapping.mapper import Mapper
from hiermap_cli.simulation.simulator import simulate

CONFIG = NoiseConfig(odometry_range=(0.02, 30.0), walls_range=(1e-4, 10.0))


def updates(seed, draws, k=14, n=9):
    """Surprises of consistent updates: innovations drawn from the S that the filter has."""
    rng = np.random.default_rng(seed)
    P, R = random_covariance(rng, n, 0.1), random_covariance(rng, k, 0.05)
    H = rng.normal(size=(k, n))
    told = gain_of(P, np.arange(n), H, R)
    for y in rng.multivariate_normal(np.zeros(k), told.S, size=draws):
        delta, after, nis = condition(P, told, y)
        yield surprise(nis, k, delta[:3], (P - after)[:3, :3]), nis


def test_both_parts_are_chi_square_and_independent():
    k, draws = 14, 3000
    seen = [(3.0 * s.robot, (k - 3) * s.rest) for s, _ in updates(1, draws, k)]
    robot, rest = np.array(seen).T
    assert robot.mean() == pytest.approx(3.0, abs=4 * np.sqrt(6 / draws))
    assert rest.mean() == pytest.approx(k - 3, abs=4 * np.sqrt(2 * (k - 3) / draws))
    assert scipy.stats.kstest(robot, scipy.stats.chi2(3).cdf).pvalue > 1e-3
    assert scipy.stats.kstest(rest, scipy.stats.chi2(k - 3).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(robot, rest)[0, 1]) < 4 / np.sqrt(draws)


def test_the_two_parts_are_all_of_it():
    for s, nis in updates(2, 50):
        assert 3.0 * s.robot + 11.0 * s.rest == pytest.approx(nis)


def test_a_robot_known_exactly_is_no_surprise():
    """Nothing of the robot shrinks: all of the NIS is the walls'."""
    told = surprise(20.0, 13, np.zeros(3), np.zeros((3, 3)))
    assert told.robot == pytest.approx(0.0)
    assert told.rest == pytest.approx(2.0)


def closed_loop(truth, seed, steps=1500, rate=0.02, k=10, outliers=0.0, config=CONFIG):
    """Factors along a run in which the filter uses what it has learnt so far.

    A robot moves by steps of unknown noise and sees k rows of known walls; both noises are
    `truth` times what the filter is told.
    """
    rng = np.random.default_rng(seed)
    Q, R = np.diag([0.02, 0.02, 0.01]) ** 2, 0.01**2 * np.eye(k)
    scale, P, error = NoiseScale(), np.zeros((3, 3)), np.zeros(3)
    history = []
    for _ in range(steps):
        error = error + rng.normal(size=3) * np.sqrt(truth.odometry * np.diagonal(Q))
        P = P + scale.odometry * Q
        H = rng.normal(size=(k, 3))
        y = H @ error + np.sqrt(truth.walls) * 0.01 * rng.normal(size=k)
        if rng.random() < outliers:
            y = y + 10.0 * 0.01 * rng.normal(size=k)
        told = gain_of(P, np.arange(3), H, scale.walls * R)
        delta, after, nis = condition(P, told, y)
        scale = adapted(scale, surprise(nis, k, delta, P - after), rate, config)
        error, P = error - delta, after
        history.append(scale)
    return np.array(history)


@pytest.mark.parametrize(
    "truth", [NoiseScale(1.0, 1.0), NoiseScale(4.0, 1.0), NoiseScale(0.2, 3.0), NoiseScale(6, 0.1)]
)
def test_finds_the_true_factors(truth):
    settled = np.log(closed_loop(truth, 3)[-700:]).mean(axis=0)
    # A little too small: what is worse than WORST counts as that.
    assert np.exp(settled[0]) == pytest.approx(truth.odometry, rel=0.2)
    assert np.exp(settled[1]) == pytest.approx(truth.walls, rel=0.12)


def test_outliers_are_not_taken_for_noise():
    """One scan in 20 off by ten sigmas in every row: variances 100 times as large would be
    six times the noise in the mean."""
    settled = np.log(closed_loop(NoiseScale(), 4, outliers=0.05)[-700:]).mean(axis=0)
    assert np.exp(settled).max() < 1.5
    assert np.exp(settled).min() > 0.7


def test_one_update_moves_little_and_in_its_direction():
    rate = 0.01
    worst = adapted(NoiseScale(), Surprise(1e6, 1e6), rate, CONFIG)
    assert worst.odometry == worst.walls == pytest.approx(np.exp(rate * (WORST - 1.0)))
    best = adapted(NoiseScale(), Surprise(0.0, 0.0), rate, CONFIG)
    assert best.odometry == best.walls == pytest.approx(np.exp(-rate))
    assert adapted(NoiseScale(2.0, 0.5), Surprise(1.0, 1.0), rate, CONFIG) == NoiseScale(2.0, 0.5)
    apart = adapted(NoiseScale(), Surprise(2.0, 0.5), rate, CONFIG)
    assert apart.odometry > 1.0 > apart.walls


def test_factors_stay_within_their_bounds():
    scale = NoiseScale()
    for _ in range(2000):
        scale = adapted(scale, Surprise(0.0, 9.0), 0.1, CONFIG)
    assert scale.odometry == CONFIG.odometry_range[0]
    assert scale.walls == CONFIG.walls_range[1]


def test_a_rate_of_zero_takes_the_figures_as_they_are():
    assert adapted(NoiseScale(), Surprise(9.0, 9.0), 0.0, CONFIG) == NoiseScale()


# --- the laser, by the residuals of line fits ---


def fits(seed, factor, n=400, points=30):
    rng = np.random.default_rng(seed)
    degrees = rng.integers(points // 2, 2 * points, n)
    return factor * rng.chisquare(degrees), degrees


@pytest.mark.parametrize("factor", [0.04, 1.0, 2.5])
def test_the_lasers_factor_is_that_of_the_residuals(factor):
    chi2, degrees = fits(1, factor)
    # The median of chi-square over its degrees of freedom is 2 / (9 degrees) below 1.
    assert residual_factor(chi2, degrees, CONFIG) == pytest.approx(factor, rel=0.06)


def test_walls_that_are_no_lines_do_not_make_the_laser_noisy():
    chi2, degrees = fits(2, 1.0)
    chi2[::4] *= 400.0
    assert residual_factor(chi2, degrees, CONFIG) == pytest.approx(1.0, rel=0.2)


def test_short_fits_do_not_tell_the_lasers_noise():
    chi2, degrees = fits(3, 1.0)
    short = np.full(1000, 2)
    both = np.concatenate((chi2, np.full(1000, 50.0))), np.concatenate((degrees, short))
    assert residual_factor(*both, CONFIG) == residual_factor(chi2, degrees, CONFIG)
    assert residual_factor(np.full(1000, 50.0), short, CONFIG) == 1.0


def test_a_few_fits_do_not_tell_it_either_and_bounds_hold():
    chi2, degrees = fits(4, 2.0, n=5)
    assert residual_factor(chi2, degrees, CONFIG) == 1.0
    chi2, degrees = fits(4, 1e6)
    assert residual_factor(chi2, degrees, CONFIG) == CONFIG.laser_range[1]
    assert residual_factor(0.0 * chi2, degrees, CONFIG) == CONFIG.laser_range[0]


def test_it_is_learnt_in_one_area():
    """Where a robot goes through a door, the walls behind it tell of the noise as well."""
    simulation = simulate(world_of(TWO_ROOMS), np.random.default_rng(1))
    by_doors, in_one = Mapper(Config()), Mapper(Config(), one_area=True)
    for mapper in (by_doors, in_one):
        for block in simulation.blocks():
            mapper.take(block)
        mapper.finish()
    assert len(by_doors.areas) == 2
    assert len(in_one.areas) == 1
    assert not in_one.portals
    assert in_one.counts.keys == by_doors.counts.keys
    assert in_one.counts.failed == 0
