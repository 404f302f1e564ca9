"""The global frame is the robot at the first scan, unless a start pose is given."""

from __future__ import annotations

import numpy as np
from world_cases import DATASETS

from hiermap_cli.config import Config
from hiermap_cli.geometry import se2
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.mapping.run import map_log

START = np.array([3.0, -2.0, 0.7])


def mapped(config):
    recording = open_recording([DATASETS / "room_corridor" / "log.mcap"], config.input)
    return map_log(recording.blocks(), config)


def test_everything_in_g_goes_with_the_start_pose():
    plain = mapped(Config())
    moved = mapped(Config(start_pose=tuple(START.tolist())))
    assert np.abs(plain.trajectory.poses[0]).max() == 0.0
    off = se2.compose(START, plain.trajectory.poses) - moved.trajectory.poses
    off[:, 2] = se2.wrap(off[:, 2])
    assert np.abs(off).max() < 1e-9
    for (name, before), (same, after) in zip(
        plain.model.environment.areas, moved.model.environment.areas, strict=True
    ):
        assert name == same
        assert np.allclose(se2.compose(START, before.mean), after.mean, atol=1e-9)
    for door, other in zip(
        plain.model.environment.doors, moved.model.environment.doors, strict=True
    ):
        assert np.allclose(se2.compose(START, door.estimate.mean), other.estimate.mean, atol=1e-9)
