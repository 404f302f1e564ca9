"""People who walk about and a robot that is carried change nothing of the map."""

from __future__ import annotations

import numpy as np
import pytest
from accident_cases import BARS, FAR, FROM_DOOR, lifted, outcome
from world_cases import DATASETS

from hiermap_cli.simulation.world import load_world


def spec(name):
    return load_world(DATASETS / f"{name}.yaml").spec


@pytest.mark.parametrize("seed", range(5))
def test_a_lift_is_some_three_metres_far_and_in_no_doorway(seed):
    ring = spec("ring")
    world = lifted(ring, np.random.default_rng(seed))
    (lift,) = world.spec.lifts
    before, after = world.journey.poses(np.array([lift.at - 1e-3, lift.at + lift.pause]))[:, :2]
    assert FAR[0] - 0.1 < np.hypot(*(after - before)) < FAR[1] + 0.1
    assert min(np.hypot(*(before - door.at)) for door in ring.doors) > FROM_DOOR - 0.01


@pytest.mark.parametrize(("scenario", "seed"), [("people", 1), ("lifted", 0)])
def test_a_ring_comes_right_in_spite_of(scenario, seed):
    came = outcome(spec("ring"), scenario, seed)
    assert came.wrong == ""
    assert came.end < BARS["ring"]


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["plain", "people", "lifted"])
@pytest.mark.parametrize(("name", "seeds"), [("ring", range(8)), ("office", range(3, 6))])
def test_the_success_rate_is_the_same_with_accidents(name, scenario, seeds):
    for seed in seeds:
        came = outcome(spec(name), scenario, seed)
        assert came.wrong == "", f"seed {seed}"
        assert came.end < BARS[name], f"seed {seed}"
