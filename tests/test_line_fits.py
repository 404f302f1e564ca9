"""Line fits from moments and by maximum likelihood, against direct ones."""

from __future__ import annotations

import numpy as np
import pytest
from scan_cases import HALF, block, cast
from scipy.optimize import least_squares

from hiermap_cli.config import LaserConfig
from hiermap_cli.perception.beams import arrange
from hiermap_cli.perception.fitting import (
    Lines,
    fit_moments,
    gather,
    inner_moments,
    least_scatter,
    refine,
    run_moments,
)

SIGMA = 0.02


def direct(points):
    """Normal (away from the origin), offset and scatter of the total least squares line."""
    centre = points.mean(axis=0)
    _, size, axes = np.linalg.svd(points - centre)
    normal = axes[1] * np.sign(axes[1] @ centre)
    return normal, normal @ centre, size[1] ** 2


@pytest.mark.parametrize("distance", [1.0, 10.0, 80.0])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_moments_lose_no_digits_far_from_the_laser(distance, noise):
    rng = np.random.default_rng(3)
    runs = []
    for turn in rng.uniform(-3.1, 3.1, 40):
        t = np.array((np.cos(turn), np.sin(turn)))
        n = rng.integers(5, 60)
        along = np.sort(rng.uniform(-0.3, 0.3, n))[:, None] * t
        centre = distance * np.array((np.cos(turn * 7), np.sin(turn * 7)))
        runs.append(centre + along + noise * rng.standard_normal((n, 2)))
    points = np.concatenate(runs)
    starts = np.cumsum([0, *map(len, runs[:-1])])
    sums = run_moments(points[:, 0], points[:, 1], starts)
    lines, scatter = fit_moments(sums)
    np.testing.assert_array_equal(scatter, least_scatter(sums))
    for k, run in enumerate(runs):
        normal, d, least = direct(run)
        sine = lines.nx[k] * normal[1] - lines.ny[k] * normal[0]
        assert abs(sine) < 1e-7
        assert abs(scatter[k] - least) < 1e-9
        # A wall through the laser may be seen from either side.
        assert abs(abs(lines.d[k]) - abs(d)) < 1e-7 * max(distance, 1.0)


def test_moments_of_the_insides_of_runs():
    rng = np.random.default_rng(4)
    x, y = rng.normal(size=(2, 50))
    for first, last in (
        ((0, 10, 30), (9, 29, 49)),
        ((2, 12, 33), (7, 12, 45)),
        ((0,), (49,)),
        ((5, 8), (7, 49)),
    ):
        sums = inner_moments(x, y, np.array(first), np.array(last))
        for k, (a, b) in enumerate(zip(first, last, strict=True)):
            u, v = x[a : b + 1], y[a : b + 1]
            expected = [len(u), u.sum(), v.sum(), (u * u).sum(), (u * v).sum(), (v * v).sum()]
            np.testing.assert_allclose(sums[:, k], expected, atol=1e-12)


@pytest.mark.parametrize("incidence", [0.0, 0.6, 1.2])
def test_the_final_fit_is_the_maximum_likelihood_one(incidence):
    laser = LaserConfig(sigma_range=SIGMA, sigma_range_scale=0.01)
    rng = np.random.default_rng(5)
    t = np.array((-np.sin(incidence), np.cos(incidence)))
    a, b = np.array((3.0, 0.0)) - 1.5 * t, np.array((3.0, 0.0)) + 1.5 * t
    true = cast([(*a, *b)], (0.0, 0.0, 0.0), HALF.angles())
    beams = arrange(block((true + SIGMA * rng.standard_normal(true.shape))[None]), laser, 30.0)
    count = len(beams.cell)
    members = gather(beams, np.arange(count), np.array([count]))
    lines, _ = fit_moments(run_moments(beams.x, beams.y, np.array([0])))
    fit = refine(members, refine(members, lines, laser).lines, laser)

    def residuals(line):
        ahead = (np.cos(line[0]) * beams.x + np.sin(line[0]) * beams.y) / beams.r
        foretold = line[1] / ahead
        return (beams.r - foretold) / weight

    # The noise is that at the wall's range, not at the measured one.
    weight = laser.sigma_range + laser.sigma_range_scale * true[np.isfinite(true)]
    start = (np.arctan2(lines.ny[0], lines.nx[0]), lines.d[0])
    best = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    alpha = np.arctan2(fit.lines.ny[0], fit.lines.nx[0])
    sigma = np.sqrt(np.linalg.inv(best.jac.T @ best.jac).diagonal())
    np.testing.assert_allclose((alpha, fit.lines.d[0]), best.x, atol=0.02 * sigma.min())

    # At the centre angle and offset are not correlated, and have the variances of that fit.
    lever = np.cos(alpha) * fit.cy[0] - np.sin(alpha) * fit.cx[0]
    J = np.array(((1.0, 0.0), (-lever, 1.0)))
    centred = J @ np.linalg.inv(best.jac.T @ best.jac) @ J.T
    np.testing.assert_allclose(centred[0, 0], fit.var_alpha[0], rtol=0.02)
    np.testing.assert_allclose(centred[1, 1], fit.var_d[0], rtol=0.02)
    assert abs(centred[0, 1]) < 0.05 * np.sqrt(centred[0, 0] * centred[1, 1])
    assert fit.chi2[0] == pytest.approx(2 * best.cost, rel=0.02)


def test_points_that_do_not_count_are_as_if_not_there():
    laser = LaserConfig(sigma_range=SIGMA)
    rng = np.random.default_rng(6)
    ranges = cast([(3.0, -1.0, 3.4, 1.0)], (0.0, 0.0, 0.0), HALF.angles())
    ranges += SIGMA * rng.standard_normal(ranges.shape)
    beams = arrange(block(ranges[None]), laser, 30.0)
    count = len(beams.cell)
    keep = rng.uniform(size=count) > 0.3
    start = Lines(*np.array(((1.0,), (0.0,), (3.2,))))
    masked = refine(gather(beams, np.arange(count), np.array([count])), start, laser, keep)
    alone = refine(gather(beams, np.flatnonzero(keep), np.array([keep.sum()])), start, laser)
    for one, other in zip((*masked.lines, *masked[1:5]), (*alone.lines, *alone[1:5]), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)
