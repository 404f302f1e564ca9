"""The command line: exit statuses, what goes where, and one line for every error."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from samples import hiermap, names, program, sample_result

from hiermap_cli.batch.run_log import Observer, default_output, run_log
from hiermap_cli.commands.options import MountValue, parse_mount
from hiermap_cli.config import Config, NoiseConfig
from hiermap_cli.errors import EXIT_FAULT, EXIT_INPUT, EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE
from hiermap_cli.mapping import run as mapper
from hiermap_cli.mapping.model import Trajectory

FILES = [
    "map.svg",
    "model.json",
    "report.json",
    "trajectory.tum",
    "trajectory_covariance.txt",
    "trajectory_filter.tum",
]


def carmen_log(path: Path, scans: int = 40) -> Path:
    """A robot that drives along a wall."""
    lines = ["PARAM robot_frontlaser_offset 0.1"]
    for i in range(scans):
        ranges = " ".join(f"{2.0 + 0.01 * beam:.2f}" for beam in range(181))
        pose = f"{0.1 * i:.3f} 0.0 0.0"
        lines.append(f"FLASER 181 {ranges} {pose} {pose} {100 + 0.2 * i:.3f} host {0.2 * i:.3f}")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def log(tmp_path):
    return carmen_log(tmp_path / "walk.carmen")


@pytest.fixture
def mapped(monkeypatch):
    """`map_log` gives the sample model at the stamps of the log."""

    def map_log(blocks, *_):
        blocks = list(blocks)
        stamps = np.concatenate([block.stamps_ns for block in blocks])
        result = sample_result(len(stamps))
        tracks = {
            name: Trajectory(stamps, track.poses, track.covariances)
            for name, track in (
                ("trajectory", result.trajectory),
                ("trajectory_filter", result.trajectory_filter),
            )
        }
        return replace(result, **tracks)

    monkeypatch.setattr(mapper, "map_log", map_log)


# --- run ---


@pytest.mark.usefixtures("mapped")
def test_run_writes_every_file(log, tmp_path):
    status, out, err = hiermap("run", log, "-o", tmp_path / "out")
    assert (status, out) == (EXIT_OK, "")
    assert names(tmp_path / "out") == FILES
    assert "areas: 2: 1 room, 1 corridor" in err
    assert "landmarks: 4: 1 corner_concave, 1 corner_convex, 2 door" in err
    assert "doors: 1, 2 crossings" in err
    assert "odometry error corrected" in err
    assert "\x1b" not in err
    status, out, err = hiermap("validate", *sorted((tmp_path / "out").iterdir()))
    assert (status, err) == (EXIT_OK, "")
    assert len(out.splitlines()) == len(FILES)


@pytest.mark.usefixtures("mapped")
def test_the_report_tells_what_was_read(log, tmp_path):
    assert hiermap("run", log, "-o", tmp_path / "out")[0] == EXIT_OK
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["input"]["log"] == "walk.carmen"
    assert report["input"]["scans"] == 40
    assert report["input"]["dropped"]["too_far"] == 2  # from the estimator
    assert str(tmp_path) not in (tmp_path / "out" / "report.json").read_text()
    values = {metric["name"]: metric["value"] for metric in report["metrics"]}
    assert values["matches"] == 120.0
    assert values["areas"] == 2.0
    assert values["odometry_correction_end"] > 0.0
    assert {"open", "read", "filter", "write", "processor", "total"} <= set(report["timing"])


@pytest.mark.usefixtures("mapped")
def test_run_without_output_takes_the_name_of_the_log(log):
    assert hiermap("run", log)[0] == EXIT_OK
    assert names(log.with_name("walk.hiermap")) == FILES


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("a.mcap", "a.hiermap"),
        ("log.carmen.gz", "log.hiermap"),
        ("with.dots.in.it.bag", "with.dots.in.it.hiermap"),
        ("rosbag2_folder", "rosbag2_folder.hiermap"),
        ("UPPER.MCAP", "UPPER.hiermap"),
    ],
)
def test_default_output(name, folder):
    assert default_output(Path("some") / name) == Path("some") / folder


@pytest.mark.usefixtures("mapped")
def test_an_existing_result_needs_force(log, tmp_path):
    assert hiermap("run", log, "-o", tmp_path / "out")[0] == EXIT_OK
    before = (tmp_path / "out" / "report.json").stat().st_mtime_ns
    status, _, err = hiermap("run", log, "-o", tmp_path / "out")
    assert status == EXIT_USAGE
    assert "--force" in err
    assert len(err.splitlines()) == 1
    assert (tmp_path / "out" / "report.json").stat().st_mtime_ns == before
    assert hiermap("run", log, "-o", tmp_path / "out", "--force")[0] == EXIT_OK
    assert names(tmp_path) == ["out", "walk.carmen"]


@pytest.mark.usefixtures("mapped")
def test_two_runs_give_the_same_bytes(log, tmp_path):
    for name in ("a", "b"):
        assert hiermap("run", log, "-o", tmp_path / name, "--quiet")[0] == EXIT_OK
    for name in set(FILES) - {"report.json"}:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


@pytest.mark.usefixtures("mapped")
def test_quiet_and_json(log, tmp_path):
    status, out, err = hiermap("run", log, "-o", tmp_path / "out", "--quiet", "--json")
    assert (status, err) == (EXIT_OK, "")
    summary = json.loads(out)
    assert summary["metrics"]["doors"] == 1.0
    assert summary["output"] == str(tmp_path / "out")
    assert summary["scans"] == 40


@pytest.mark.usefixtures("mapped")
def test_verbose_tells_events_and_times(log, tmp_path):
    status, _, err = hiermap("run", log, "-o", tmp_path / "out", "-v")
    assert status == EXIT_OK
    assert "area_entered area=A2 door=D1" in err
    assert "in filter" in err


@pytest.mark.usefixtures("mapped")
def test_warnings_of_the_input_are_shown(tmp_path):
    log = carmen_log(tmp_path / "a.log")
    log.write_text("\n".join(log.read_text().splitlines()[1:]))  # without the laser's mount
    _, _, err = hiermap("run", log, "-o", tmp_path / "out")
    (warning,) = [line for line in err.splitlines() if line.startswith("warning: ")]
    assert "mount" in warning
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert "mount" in report["input"]["warnings"][0]


def test_a_map_with_nothing_in_it_is_warned_of(tmp_path):
    log = carmen_log(tmp_path / "one.carmen", scans=1)
    status, _, err = hiermap("run", log, "-o", tmp_path / "out")
    assert status == EXIT_OK
    said = [line for line in err.splitlines() if line.startswith("warning: no landmarks")]
    assert len(said) == 1
    assert "in 1 scan:" in said[0]
    assert "`hiermap inspect`" in said[0]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert f"warning: {report['input']['warnings'][-1]}" == said[0]


class Seen(Observer):
    """What an observer is told, in its order."""

    def __init__(self):
        self.told = []

    def advanced(self, scans):
        self.told.append(scans)

    def entered(self, stage):
        self.told.append(stage)


def test_a_section_that_is_none_is_said_in_plain_words(log, tmp_path):
    config = tmp_path / "c.yaml"
    config.write_text("filter: 3\n")
    status, _, err = hiermap("run", log, "-o", tmp_path / "out", "--config", config)
    assert status == EXIT_USAGE
    assert "filter: must be a section of keys and values, not 3" in err


def test_a_negative_start_is_wrong_usage(log, tmp_path):
    status, _, err = hiermap("run", log, "-o", tmp_path / "out", "--start", "-5")
    assert status == EXIT_USAGE
    assert "--start" in err


@pytest.mark.parametrize("warm_up", [0, 1, 1000])
def test_the_observer_is_told_of_every_scan_then_of_the_stages(log, tmp_path, warm_up):
    seen = Seen()
    config = Config(noise=NoiseConfig(warm_up=warm_up))
    run_log([log], config, tmp_path / "out", observer=seen)
    assert seen.told == [32, 8, "refining", "writing"]


@pytest.mark.usefixtures("mapped")
def test_the_configuration_reaches_the_report(log, tmp_path):
    config = tmp_path / "c.yaml"
    config.write_text("segmentation: {min_points: 7}\ninput: {start: 1.0}\n")
    options = ("--config", config, "--end", "5", "--mount", "0.2,0,3.1,flipped", "-q")
    assert hiermap("run", log, "-o", tmp_path / "out", *options)[0] == EXIT_OK
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["config"]["segmentation"]["min_points"] == 7
    assert report["config"]["input"]["start"] == 1.0
    assert report["config"]["input"]["end"] == 5.0
    assert report["config"]["input"]["mount"] == {"x": 0.2, "y": 0.0, "yaw": 3.1, "flipped": True}
    assert report["input"]["scans"] == 21


def test_five_faults_of_a_configuration_are_five_lines(log, tmp_path):
    config = tmp_path / "c.yaml"
    config.write_text(
        "segmentation:\n  min_points: 1\n  min_length: -1\n  typo: 3\nlaser:\n  sigma_range: no\n"
        "update: magic\n"
    )
    status, out, err = hiermap("run", log, "-o", tmp_path / "out", "--config", config)
    assert (status, out) == (EXIT_USAGE, "")
    lines = err.splitlines()
    assert len(lines) == 5
    for line, path in zip(
        lines,
        ("segmentation.min_points", "segmentation.min_length", "segmentation.typo",
         "laser.sigma_range", "update"),
        strict=True,
    ):  # fmt: skip
        assert str(config) in line
        assert path in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["run"],
        ["run", "LOG", "--mount", "1,2"],
        ["run", "LOG", "--mount", "1,2,x"],
        ["run", "LOG", "--mount", "1,2,nan"],
        ["run", "LOG", "--mount", "1,2,3,upside"],
        ["run", "LOG", "--start", "x"],
        ["run", "LOG", "--start", "5", "--end", "5"],
        ["run", "LOG", "--nonsense"],
        ["run", "LOG", "--config", "none.yaml"],
        ["nonsense"],
        ["validate"],
    ],
)
def test_wrong_usage_is_status_2(log, tmp_path, arguments):
    arguments = [str(log) if a == "LOG" else a for a in arguments]
    done = program(*arguments, cwd=tmp_path)
    assert done.returncode == EXIT_USAGE
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("hiermap: ")
    assert names(tmp_path) == ["walk.carmen"]


@pytest.mark.parametrize(
    "content", [b"", b"nothing known\n", b"\x00" * 100, b"FLASER 3 1 2\n", b"\x89MCAP0\r\n", None]
)
def test_a_log_that_cannot_be_used_is_status_1_and_one_line(tmp_path, content):
    path = tmp_path / "bad.log"
    if content is not None:
        path.write_bytes(content)
    status, out, err = hiermap("run", path, "-o", tmp_path / "out")
    assert (status, out) == (EXIT_INPUT, "")
    assert len(err.splitlines()) == 1
    assert "bad.log" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "mount"),
    [
        ("0.1,0,3.14", MountValue(0.1, 0.0, 3.14, flipped=False)),
        (" 1 , 2 , -3e-1 , flipped ", MountValue(1.0, 2.0, -0.3, flipped=True)),
    ],
)
def test_mounts(text, mount):
    assert parse_mount(text) == mount


# --- faults of the program ---


def raising(error: BaseException):
    def map_log(*_):
        raise error

    return map_log


def test_a_fault_leaves_a_traceback_beside_the_output(log, tmp_path, monkeypatch):
    monkeypatch.setattr(mapper, "map_log", raising(ZeroDivisionError("a fault\nof two lines")))
    (tmp_path / "results").mkdir()
    status, out, err = hiermap("run", log, "-o", tmp_path / "results" / "out")
    assert (status, out) == (EXIT_FAULT, "")
    (line,) = err.splitlines()
    (file,) = names(tmp_path / "results")
    assert re.fullmatch(r"hiermap-traceback-.*\.txt", file)
    assert file in line
    assert "ZeroDivisionError" in (tmp_path / "results" / file).read_text()


def test_a_fault_with_v_shows_its_traceback(log, tmp_path, monkeypatch):
    monkeypatch.setattr(mapper, "map_log", raising(ZeroDivisionError()))
    status, _, err = hiermap("run", log, "-o", tmp_path / "out", "-v")
    assert status == EXIT_FAULT
    assert "Traceback (most recent call last)" in err
    assert names(tmp_path) == ["walk.carmen"]


def test_a_result_that_no_document_can_carry_is_a_fault(log, tmp_path, monkeypatch):
    def unsound(blocks, *_):
        assert sum(map(len, blocks)) == 40
        result = sample_result(40)
        poses = result.trajectory.poses.copy()
        poses[7] = np.nan
        return replace(result, trajectory=replace(result.trajectory, poses=poses))

    monkeypatch.setattr(mapper, "map_log", unsound)
    status, _, err = hiermap("run", log, "-o", tmp_path / "out")
    assert status == EXIT_FAULT
    assert "UnsoundValueError" in err
    assert not (tmp_path / "out").exists()


def test_an_interruption_leaves_nothing(log, tmp_path, monkeypatch):
    monkeypatch.setattr(mapper, "map_log", raising(KeyboardInterrupt()))
    status, _, err = hiermap("run", log, "-o", tmp_path / "out")
    assert status == EXIT_INTERRUPTED
    assert err.splitlines() == ["hiermap: interrupted"]
    assert names(tmp_path) == ["walk.carmen"]


SLEEPER = """
import sys, time
from hiermap_cli.mapping import run as mapper

def map_log(*_):
    print("ready", flush=True)
    time.sleep(60)

mapper.map_log = map_log
from hiermap_cli.commands.main import main
main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_with_130(log, tmp_path, number):
    command = [sys.executable, "-c", SLEEPER, "run", str(log), "-o", str(tmp_path / "out")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        _, err = process.communicate(timeout=30)
    assert process.returncode == EXIT_INTERRUPTED
    assert err.splitlines() == ["hiermap: interrupted"]
    assert names(tmp_path) == ["walk.carmen"]
