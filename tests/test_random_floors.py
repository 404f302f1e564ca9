"""Floors that nobody has seen before, by four kinds of laser: the map is the building."""

from __future__ import annotations

import numpy as np
import pytest
from floor_cases import LASERS, random_floor

from hiermap_cli.config import Config
from hiermap_cli.documents.tum import TimedPoses
from hiermap_cli.evaluation.judge import Given, Run, judge
from hiermap_cli.mapping.run import map_log
from hiermap_cli.simulation.simulator import simulate


def figures(laser: str, seed: int, folder):
    """Metrics by name, and what else is to be said, of a floor mapped with the defaults."""
    rng = np.random.default_rng(seed)
    floor = random_floor(laser, rng, folder)
    simulation = simulate(floor, rng)
    result = map_log(simulation.blocks(), Config())
    truth = TimedPoses(simulation.stamps_ns, simulation.truth)
    run = Run(result.trajectory, result.model)
    document = judge(run, Given(reference=simulation.reference_map, truth=truth)).document
    return {metric.name: metric.value for metric in document.metrics}


def check(laser: str, seed: int, folder):
    found = figures(laser, seed, folder)
    exact = ("area_f1_iou50", "door_precision", "door_recall", "topology_precision")
    for name in (*exact, "topology_recall", "corner_precision"):
        assert found[name] == 1.0, (name, found[name])
    assert found["ate_rmse"] < 0.1
    assert found["wall_rmse"] < 0.05


def test_a_floor_drawn_by_chance(tmp_path):
    check("three quarters of 12 m", 1, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 4])
@pytest.mark.parametrize("laser", LASERS)
def test_floors_by_every_laser(laser, seed, tmp_path):
    check(laser, seed, tmp_path)
