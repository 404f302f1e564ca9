"""`hiermap run` as a whole on the logs of datasets/: documents, determinism, conversion."""

from __future__ import annotations

import json
import os
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from real_data import DATA
from samples import hiermap, names, program

from hiermap_cli.documents.model_load import load_model
from hiermap_cli.documents.schema import shipped_schema
from hiermap_cli.documents.trajectories import read_covariances
from hiermap_cli.documents.tum import read_tum
from hiermap_cli.errors import EXIT_OK
from hiermap_cli.geometry.se2 import compose

DATASETS = Path(__file__).resolve().parents[1] / "datasets"
WORLDS = ("ring", "room_corridor", "room")
EXACT = ("model.json", "trajectory.tum", "trajectory_filter.tum", "trajectory_covariance.txt")


def run(log: Path, folder: Path, seed: str = "0") -> Path:
    environment = {**os.environ, "PYTHONHASHSEED": seed}
    done = program("run", log, "-o", folder, "--quiet", env=environment)
    assert done.returncode == EXIT_OK, done.stderr
    assert done.stderr == ""
    return folder


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A result of every world, made once."""
    folder = tmp_path_factory.mktemp("results")
    return {name: run(DATASETS / name / "log.mcap", folder / name) for name in WORLDS}


@pytest.mark.parametrize("name", WORLDS)
def test_every_file_is_there_and_valid(results, name):
    folder = results[name]
    assert set(names(folder)) == {*EXACT, "report.json", "map.svg"}
    status, _, err = hiermap("validate", *sorted(folder.iterdir()))
    assert (status, err) == (EXIT_OK, "")
    for document in ("model", "report"):
        validator = jsonschema.Draft202012Validator(json.loads(shipped_schema(document)))
        validator.validate(json.loads((folder / f"{document}.json").read_text()))


@pytest.mark.parametrize("name", WORLDS)
def test_a_line_for_every_scan(results, name):
    truth = read_tum(DATASETS / name / "truth.tum")
    for file in ("trajectory.tum", "trajectory_filter.tum"):
        assert (read_tum(results[name] / file).stamps_ns == truth.stamps_ns).all()
    covariances = read_covariances(results[name] / "trajectory_covariance.txt")
    assert (covariances.stamps_ns == truth.stamps_ns).all()


@pytest.mark.parametrize("name", WORLDS)
def test_the_model_ends_where_the_trajectory_ends(results, name):
    model = load_model(results[name] / "model.json")
    events = json.loads((results[name] / "report.json").read_text())["events"]
    last = read_tum(results[name] / "trajectory.tum").poses[-1]
    # A loop at the environment level also moves the robot within its last area, which the poses
    # of its path there do not follow: allowed within one deviation.
    robot = model.environment.robot
    loops = any("loop" in event["kind"] or event["kind"] == "area_reentered" for event in events)
    allowed = np.sqrt(np.diagonal(robot.covariance)) if loops else 0.0
    assert (np.abs(robot.mean - last) <= allowed + 1e-6).all()
    frames = dict(model.environment.areas)
    ends = [compose(frames[area.id].mean, area.robot.mean) for area in model.areas]
    assert min(np.abs(end - robot.mean).max() for end in ends) < 1e-6


@pytest.mark.parametrize("name", WORLDS)
def test_no_path_of_this_machine_is_written(results, name):
    for file in results[name].iterdir():
        assert str(results[name].parent) not in file.read_text()
        assert str(DATASETS) not in file.read_text()


def test_two_runs_give_the_same_bytes(results, tmp_path):
    again = run(DATASETS / "ring" / "log.mcap", tmp_path / "again", seed="1")
    for file in (*EXACT, "map.svg"):
        assert (again / file).read_bytes() == (results["ring"] / file).read_bytes(), file


def assert_alike(a, b, path: str = "") -> None:
    """Equal texts and structure, numbers within 1e-6."""
    if isinstance(a, dict):
        assert list(a) == list(b), path
        for key in a:
            assert_alike(a[key], b[key], f"{path}.{key}")
    elif isinstance(a, list):
        assert len(a) == len(b), path
        for index, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_alike(x, y, f"{path}[{index}]")
    elif isinstance(a, float) and isinstance(b, float):
        assert a == pytest.approx(b, rel=1e-6, abs=1e-6), path
    else:
        assert a == b, path


@pytest.mark.parametrize(
    "log",
    [
        DATASETS / "room_corridor" / "log.mcap",
        pytest.param(
            DATA / "wean" / "robotdata5.log.gz",
            marks=pytest.mark.skipif(not DATA.exists(), reason="no real logs here"),
        ),
    ],
    ids=["mcap", "wean"],
)
def test_convert_and_run_gives_the_same_model(log, tmp_path):
    status, _, err = hiermap("convert", log, "-o", tmp_path / "converted.mcap", "-q")
    assert status == EXIT_OK, err
    one = run(log, tmp_path / "one")
    other = run(tmp_path / "converted.mcap", tmp_path / "other")
    assert_alike(
        *(json.loads((folder / "model.json").read_text()) for folder in (one, other)),
    )
    a, b = read_tum(one / "trajectory.tum"), read_tum(other / "trajectory.tum")
    assert (a.stamps_ns == b.stamps_ns).all()
    np.testing.assert_allclose(a.poses, b.poses, atol=1e-6)
