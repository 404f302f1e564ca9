"""What the filter's innovations say of its covariances, and the residuals of loops."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hiermap_cli.config import Config
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.association.innovations import Innovation, InnovationLog, Sums
from hiermap_cli.mapping.association.sighting import Matches
from hiermap_cli.mapping.environment import Anchors, Link, compose_environment, loop_residuals
from hiermap_cli.mapping.run import map_log
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import load_world

ROOM = Path(__file__).resolve().parents[1] / "datasets" / "room.yaml"
NONE = np.zeros(0, dtype=np.int64)
ZERO, ONE = np.array([0]), np.array([1])
TWO_WALLS_AND_AN_END = Matches(np.array([0, 1]), np.array([0, 2]), ZERO, ONE, ONE)
UID = np.array([10, 11, 12])


def update(rng, S, scale=1.0, carried=None):
    """One update with innovations of covariance `scale` S; `carried` innovations are kept on."""
    nu = np.linalg.cholesky(scale * S) @ rng.standard_normal(len(S))
    if carried is not None:
        nu = 0.8 * carried + 0.6 * nu
    return Innovation(nu, S.diagonal().copy(), S.diagonal(1).copy())


def correlated():
    A = np.random.default_rng(7).standard_normal((5, 5))
    return A @ A.T + np.eye(5)


def filled(scale=1.0, steps=4000, keep=False):
    rng, S, log = np.random.default_rng(1), correlated(), InnovationLog()
    nu = None
    for key in range(steps):
        rows = update(rng, S, scale, nu)
        nu = rows.nu if keep else None
        log.add(key, 3, UID, TWO_WALLS_AND_AN_END, rows)
    return log.sums(3)


@pytest.mark.parametrize("scale", [1.0, 4.0, 0.25])
def test_nis_of_each_wall_and_end_is_the_scale_of_its_true_covariance(scale):
    sums = filled(scale)
    assert sorted(sums) == [10, 11, 12]
    assert [sums[uid].degrees for uid in (10, 11, 12)] == [8000.0, 4000.0, 8000.0]
    for one in sums.values():
        assert one.nis == pytest.approx(scale, rel=0.08)
        assert abs(one.lag1) < 0.05


def test_innovations_that_depend_on_the_last_ones_are_not_white():
    for one in filled(keep=True).values():
        assert one.nis == pytest.approx(1.0, rel=0.15)
        assert one.lag1 == pytest.approx(0.8, abs=0.05)


def test_only_successive_key_scans_make_pairs():
    log, rows = InnovationLog(), Innovation(np.array([1.0]), np.ones(1), np.zeros(0))
    only_end = Matches(NONE, NONE, np.array([0]), np.array([0]), np.array([0]))
    for key in (0, 1, 3, 4, 5):
        log.add(key, 0, np.array([5]), only_end, rows)
    assert log.sums(0) == {5: Sums(5.0, 5.0, 5.0, 3.0, 3.0)}
    assert log.sums(1) == {}
    assert math.isnan(Sums().nis)
    assert math.isnan(Sums().lag1)


def square(error: float) -> tuple[list[Anchors], list[Link]]:
    """Two areas with two common places each; the second way round is `error` metres off."""
    sigma = 0.1
    here = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    there = here + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [error, 0.0, 0.0]])
    free = np.zeros(9)
    free[6:8] = sigma**2  # only where the second place lies is uncertain
    free[8] = sigma**2
    areas = [Anchors(here, np.diag(free)), Anchors(there, np.zeros((9, 9)))]
    return areas, [Link(0, 1, 1, 1), Link(1, 2, 0, 2)]


def test_a_loop_residual_by_hand():
    areas, links = square(0.2)
    (found,) = loop_residuals(areas, links, np.zeros(3), np.zeros((3, 3)))
    assert found.link == links[1]
    assert found.between == pytest.approx([-0.2, 0.0, 0.0], abs=1e-12)
    assert found.nis == pytest.approx((0.2 / 0.1) ** 2 / 3.0, rel=1e-6)
    # After the constraint both ways lead to the same place.
    environment = compose_environment(areas, links, np.zeros(3), np.zeros((3, 3)))
    A = se2.compose(environment.frames[0], environment.anchors[0][2])
    B = se2.compose(environment.frames[1], environment.anchors[1][2])
    assert pytest.approx(B, abs=1e-9) == A


def test_without_loops_there_are_no_residuals():
    areas, links = square(0.2)
    assert loop_residuals(areas, links[:1], np.zeros(3), np.zeros((3, 3))) == []


def test_a_run_tells_of_its_kinds_and_areas():
    simulation = simulate(load_world(ROOM), np.random.default_rng(3))
    result = map_log(simulation.blocks(), Config())
    told = result.consistency
    assert [one["area"] for one in told["areas"]] == [area.id for area in result.model.areas]
    assert {one["kind"] for one in told["kinds"]} == {l.kind for l in result.model.landmarks}
    assert sum(one["degrees"] for one in told["areas"]) == told["innovations"]["degrees"] > 1000
    named = {metric.name: metric for metric in result.metrics}
    for one in told["kinds"]:
        if one["nis"] is not None:
            assert named[f"nis_{one['kind']}"].value == one["nis"]
            assert 0.2 < one["nis"] < 3.0
    assert named["innovation_lag1"].value == told["innovations"]["lag1"]
    assert abs(told["innovations"]["lag1"]) < 0.5
