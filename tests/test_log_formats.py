"""One recording in every format: the same scans, odometry and mount come out."""

from __future__ import annotations

import log_cases as cases
import numpy as np
import pytest

from hiermap_cli.config import InputConfig
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.logs.records import Mount


def read(paths, size=256, **options):
    recording = open_recording(paths, InputConfig(**options))
    blocks = list(recording.blocks(size))
    return recording, blocks


@pytest.fixture(params=sorted(cases.FORMATS))
def paths(request, tmp_path):
    return cases.FORMATS[request.param](tmp_path)


def test_every_format_gives_the_same(paths):
    recording, blocks = read(paths)
    (block,) = blocks
    assert block.stamps_ns.tolist() == cases.stamps()
    expected = np.array([cases.ranges(i) for i in range(cases.SCANS)], dtype=np.float32)
    np.testing.assert_array_equal(block.ranges, expected)
    assert block.ranges.dtype == np.float32
    np.testing.assert_allclose(block.odometry, [cases.pose(t) for t in cases.stamps()], atol=1e-6)
    assert block.has_odometry.all()
    assert block.mount == Mount(cases.MOUNT_X, 0.0, 0.0, flipped=False)
    assert recording.mount == block.mount
    assert block.laser.beams == cases.BEAMS
    np.testing.assert_allclose(block.laser, cases.laser(), rtol=1e-6)
    report = recording.report()
    assert report.scans == cases.SCANS
    assert report.odometry >= len(cases.odometry_stamps())
    assert report.dropped == {}
    assert report.lost == ()
    assert report.warnings == ()
    assert len(report.sha256) == 64


def test_blocks_do_not_depend_on_their_size(paths):
    _, whole = read(paths)
    _, small = read(paths, size=5)
    assert [len(block) for block in small] == [5, 5, 5, 5, 4]
    for name in ("stamps_ns", "ranges", "odometry", "has_odometry"):
        joined = np.concatenate([getattr(block, name) for block in small])
        np.testing.assert_array_equal(joined, getattr(whole[0], name))


def test_a_log_can_be_read_again(paths):
    recording, (first,) = read(paths)
    (second,) = recording.blocks()
    np.testing.assert_array_equal(first.ranges, second.ranges)
    np.testing.assert_array_equal(first.odometry, second.odometry)
    assert recording.report().scans == cases.SCANS


def test_start_and_end_choose_scans(paths):
    # The first stamp is that of the first odometry reading.
    _, (block,) = read(paths, start=1.0, end=2.0)
    wanted = [t for t in cases.stamps() if 1.0 <= (t - cases.START) / 1e9 <= 2.0]
    assert block.stamps_ns.tolist() == wanted
    np.testing.assert_allclose(block.odometry, [cases.pose(t) for t in wanted], atol=1e-6)
    assert block.has_odometry.all()
