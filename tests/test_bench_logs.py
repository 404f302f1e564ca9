"""How long reading takes, by format; nothing is asserted about time."""

from __future__ import annotations

import gzip
import shutil
import time

import log_cases as cases
import numpy as np
import pytest
import room_case as room
from real_data import DATA

from hiermap_cli.config import InputConfig
from hiermap_cli.logs import cdr_write, ros_decode
from hiermap_cli.logs.convert import convert
from hiermap_cli.logs.ranges import float32
from hiermap_cli.logs.raw import finish
from hiermap_cli.logs.recording import open_recording

# Processor time: reading is never waiting.
pytestmark = [pytest.mark.bench, pytest.mark.benchmark(timer=time.process_time)]

SCANS = 2000


def read(paths):
    recording = open_recording(paths, InputConfig())
    return sum(len(block) for block in recording.blocks())


def note(benchmark, paths, scans):
    assert benchmark.pedantic(lambda: read(paths), rounds=5, warmup_rounds=1) == scans
    benchmark.extra_info |= {
        "scans": scans,
        "us_a_scan": 1e6 * benchmark.stats.stats.min / scans,
    }


@pytest.fixture(scope="module")
def carmen(tmp_path_factory):
    """Scans of 361 beams with two decimals, as a SICK gives them."""
    rng = np.random.default_rng(5)
    path = tmp_path_factory.mktemp("bench") / "log.carmen.gz"
    lines = []
    for i, row in enumerate(rng.uniform(0.5, 20.0, (SCANS, 361))):
        values = " ".join(f"{value:.2f}" for value in row)
        end = f"{i / 5 + 1:.6f} host {i / 5 + 1:.6f}"
        lines.append(f"ODOM {0.01 * i:.6f} 0 0 0 0 0 {end}")
        lines.append(f"FLASER 361 {values} 0 0 0 {0.01 * i:.6f} 0 0 {end}")
    path.write_bytes(gzip.compress("\n".join(lines).encode()))
    return path


def test_reading_carmen(benchmark, carmen):
    note(benchmark, [carmen], SCANS)


def test_reading_a_ros_2_mcap(benchmark, carmen, tmp_path):
    target = tmp_path / "log.mcap"
    convert(open_recording([carmen], InputConfig()), target)
    note(benchmark, [target], SCANS)


@pytest.mark.parametrize("kind", ["bag", "rosbag2", "mcap protobuf", "mcap json"])
def test_reading_other_formats(benchmark, tmp_path, monkeypatch, kind):
    monkeypatch.setattr(cases, "SCANS", SCANS)
    note(benchmark, cases.FORMATS[kind](tmp_path), SCANS)


@pytest.mark.skipif(not DATA.exists(), reason="the real logs are not here")
@pytest.mark.parametrize(("log", "scans"), [("fr079/log.carmen.gz", 4791), ("neato_rosbag2", 357)])
def test_reading_real_logs(benchmark, tmp_path, log, scans):
    copy = tmp_path / (DATA / log).name
    (shutil.copytree if (DATA / log).is_dir() else shutil.copy)(DATA / log, copy)
    note(benchmark, [copy], scans)


def test_decoding_a_laser_scan(benchmark):
    data = cdr_write.laser_scan(7, "laser", np.linspace(1, 9, 361), room.LASER)
    reach = float32(1e6)
    benchmark(lambda: finish(ros_decode.laser_scan_cdr(data)[0], reach))


def test_decoding_odometry(benchmark):
    data = cdr_write.odometry(7, "odom", "base_link", (1.0, 2.0, 0.5), None)
    benchmark(lambda: ros_decode.odometry_cdr(data))
