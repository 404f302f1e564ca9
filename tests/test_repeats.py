"""Scans that a log holds twice: counted once, with a line of the trajectory each."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from world_cases import DATASETS

from hiermap_cli.config import Config, InputConfig
from hiermap_cli.documents.results import write_result
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.mapping.run import map_log


@pytest.fixture(scope="module")
def scans():
    """The first scans of the room, in one block."""
    recording = open_recording([DATASETS / "room" / "log.mcap"], InputConfig())
    return next(recording.blocks(size=80))


def mapped(blocks, folder):
    result = map_log(blocks, Config())
    folder.mkdir()
    write_result(folder, result)
    return result, (folder / "model.json").read_bytes()


@pytest.mark.parametrize("size", [7, 200])
def test_repeated_scans_change_no_map_and_have_their_lines(scans, tmp_path, size):
    starts = range(0, len(scans), size)
    blocks = [scans.part(slice(at, at + size)) for at in starts]
    once, model = mapped(blocks, tmp_path / "once")
    rows = np.repeat(np.arange(len(scans)), 1 + np.arange(len(scans)) % 3)
    repeated = np.concatenate(([False], np.diff(rows) == 0))
    many = replace(scans.part(rows), repeated=repeated)
    # Repeats of a block's last scan begin the next one, as they do when a log is read.
    ends = [*(np.searchsorted(rows, at - 1) + 1 for at in starts[1:]), len(rows)]
    blocks = [many.part(slice(*span)) for span in pairwise((0, *ends))]
    twice, model_of_many = mapped(blocks, tmp_path / "twice")
    assert model_of_many == model
    for name in ("trajectory", "trajectory_filter"):
        ours, theirs = getattr(twice, name), getattr(once, name)
        for values in ("stamps_ns", "poses", "covariances"):
            np.testing.assert_array_equal(getattr(ours, values), getattr(theirs, values)[rows])
