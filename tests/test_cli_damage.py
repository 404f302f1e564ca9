"""Whatever happened to the bytes of a log, the user sees a result or one line, no traceback."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from samples import hiermap, sample_result

from hiermap_cli.errors import EXIT_INPUT, EXIT_OK
from hiermap_cli.mapping import run
from hiermap_cli.mapping.model import Trajectory

ROOT = Path(__file__).resolve().parents[1]
LOG = (ROOT / "datasets" / "room" / "log.mcap").read_bytes()


@pytest.fixture(scope="module", autouse=True)
def mapped():
    """The estimator has tests of its own; here only what surrounds it."""

    def map_log(blocks, *_):
        stamps = np.concatenate([block.stamps_ns for block in blocks])
        result = sample_result(len(stamps))
        final, by_filter = result.trajectory, result.trajectory_filter
        return replace(
            result,
            trajectory=Trajectory(stamps, final.poses, final.covariances),
            trajectory_filter=Trajectory(stamps, by_filter.poses, by_filter.covariances),
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "map_log", map_log)
        yield


def check(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "log.mcap").write_bytes(content)
        status, out, err = hiermap("run", folder / "log.mcap", "-o", folder / "out")
        assert status in (EXIT_OK, EXIT_INPUT), err
        assert out == ""
        assert "Traceback" not in err
        left = sorted(path.name for path in folder.iterdir())
        if status == EXIT_OK:
            assert left == ["log.mcap", "out"]
            report = json.loads((folder / "out" / "report.json").read_text())
            assert report["input"]["scans"] > 0
        else:
            assert left == ["log.mcap"]
            said = [line for line in err.splitlines() if not line.startswith("warning: ")]
            assert len(said) == 1
            assert said[0].startswith("hiermap: ")


@given(st.integers(0, len(LOG)))
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
def test_a_log_that_is_cut_off(length):
    check(LOG[:length])


@given(
    st.lists(st.tuples(st.integers(0, len(LOG) - 1), st.integers(0, 255)), min_size=1, max_size=20)
)
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
def test_a_log_with_wrong_bytes(changes):
    content = bytearray(LOG)
    for at, value in changes:
        content[at] = value
    check(bytes(content))


@given(st.integers(0, len(LOG) - 1), st.integers(1, 5000))
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
def test_a_log_with_a_hole(at, length):
    check(LOG[:at] + LOG[at + length :])


def test_a_log_that_is_cut_off_tells_what_was_lost(tmp_path):
    (tmp_path / "log.mcap").write_bytes(LOG[: len(LOG) // 2])
    status, _, err = hiermap("run", tmp_path / "log.mcap", "-o", tmp_path / "out")
    assert status == EXIT_OK
    assert "warning: " in err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["input"]["lost"]
    assert 0 < report["input"]["scans"] < 326
