"""Processor time and memory of closing loops on 1, 2, 4 and 8 times the floor.

`make bench` writes them down as JSON; nothing is asserted about time.
"""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from hiermap_cli.config import Config
from hiermap_cli.mapping.filtering import run_filter
from hiermap_cli.mapping.levels import compose_levels
from hiermap_cli.mapping.loops.closing import close_loops
from hiermap_cli.simulation.floors import office_floor
from hiermap_cli.simulation.simulator import simulate

pytestmark = pytest.mark.bench


@pytest.mark.parametrize("blocks", [1, 2, 4, 8])
def test_loops_of_a_growing_floor(benchmark, blocks):
    simulation = simulate(office_floor(blocks, np.random.default_rng(1)), np.random.default_rng(2))
    mapper, _ = run_filter(simulation.blocks(), Config())
    keyscans = mapper.keyscans.taken()
    poses = compose_levels(mapper).trajectory.poses[np.array(mapper.trail.key_at)]
    result = benchmark.pedantic(
        close_loops, (keyscans, poses, mapper.config, mapper.noise), rounds=3
    )
    tracemalloc.start()
    close_loops(keyscans, poses, mapper.config, mapper.noise)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    benchmark.extra_info.update(
        key_scans=len(poses), loops=len(result.edges), peak_megabytes=peak / 2**20
    )
    assert result.edges
