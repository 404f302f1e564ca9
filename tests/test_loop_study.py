"""Places that look alike, with a path that is wrong in many ways: nothing false is closed.

The study behind docs/loops.md: rooms all alike along a corridor, and a twin room entered after a
long way; drifts of scale and of curvature, and faults that are known of, some of them so many that
the robot may be anywhere in the gate and beyond.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from loop_cases import comb, drive_of, twins

from hiermap_cli.config import Config
from hiermap_cli.estimation.noise import NoiseScale
from hiermap_cli.mapping.loops.closing import close_loops

pytestmark = pytest.mark.slow

WRONG, WRONG_ANGLE = 0.4, 0.15  # the places that look alike are 3 m apart and more
ROOMS = [(0.0, 0.0), (0.02, 0.0), (0.04, 0.0), (0.0, 0.003), (0.03, -0.003)]
TWINS = [(0.0, 0.0), (0.02, 0.0), (-0.02, 0.001), (0.04, 0.0)]


def wrong_loops(world, seed: int, scale: float, curvature: float, faults: int) -> int:
    drifts = {"scale": scale, "curvature": curvature}
    drive = drive_of(world, seed, **drifts)
    if faults:
        rng = np.random.default_rng(seed + 7)
        keys = np.sort(rng.choice(np.arange(10, len(drive.poses) - 10), faults, replace=False))
        failed = {int(k): rng.normal(0.0, [0.25, 0.25, 0.12]) for k in keys}
        drive = drive_of(world, seed, **drifts, faults=failed)
    result = close_loops(drive.keyscans, drive.poses, Config(), NoiseScale())
    off = [drive.relation_error(e.key_i, e.key_j, e.R_i_j) for e in result.edges]
    return sum(np.hypot(e[0], e[1]) > WRONG or abs(e[2]) > WRONG_ANGLE for e in off)


@pytest.mark.parametrize("pitch", [3.0, 4.0])
def test_no_room_is_taken_for_one_alike(pitch):
    world = comb(6, pitch)
    for (scale, curvature), faults in product(ROOMS, (0, 3, 8)):
        assert wrong_loops(world, 1, scale, curvature, faults) == 0, (scale, curvature, faults)


@pytest.mark.parametrize("length", [60.0, 100.0])
@pytest.mark.parametrize("pitch", [3.0, 4.0])
def test_no_new_room_is_taken_for_its_twin(pitch, length):
    world = twins(pitch, length)
    for seed, (scale, curvature), faults in product((1, 2, 3, 4), TWINS, (0, 2, 6)):
        found = wrong_loops(world, seed, scale, curvature, faults)
        assert found == 0, (seed, scale, curvature, faults)
