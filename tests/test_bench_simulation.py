"""How fast logs are simulated; `make bench` writes it down, nothing is asserted about time."""

from __future__ import annotations

import numpy as np
import pytest
from world_cases import DATASETS

from hiermap_cli.simulation.floors import office_floor
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import World, load_world

pytestmark = pytest.mark.bench

SCANS = 2048


def first_scans(world: World) -> int:
    scans = 0
    for block in simulate(world, np.random.default_rng(1)).blocks():
        scans += len(block)
        if scans >= SCANS:
            break
    return scans


def test_scans_of_the_office(benchmark):
    world = load_world(DATASETS / "office.yaml")
    benchmark.extra_info["scans"] = SCANS
    assert benchmark(first_scans, world) == SCANS


def test_scans_of_200_areas(benchmark):
    world = office_floor(20, np.random.default_rng(1))
    benchmark.extra_info["scans"] = SCANS
    assert benchmark(first_scans, world) == SCANS


def test_building_a_floor_of_200_areas(benchmark):
    world = benchmark(lambda: office_floor(20, np.random.default_rng(1)))
    assert len(world.plan.areas) == 200
