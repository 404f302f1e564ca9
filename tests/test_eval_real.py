"""Evaluation against real references, where the logs are present: runs of minutes."""

from __future__ import annotations

import gzip
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image
from real_data import DATA

from hiermap_cli.batch.evaluate_run import evaluate_run
from hiermap_cli.batch.run_log import run_log
from hiermap_cli.config import Config
from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

FR079, WEAN = DATA / "fr079", DATA / "wean"
pytestmark = pytest.mark.skipif(not FR079.exists(), reason="the real logs are not here")


def test_the_slam_reference_of_fr079_on_its_relations(tmp_path):
    """The figure of GMapping's poses on this log is 0.05 m."""
    (tmp_path / "trajectory.tum").write_bytes((FR079 / "slam_reference.tum").read_bytes())
    values = evaluate_run(tmp_path, relations=FR079 / "relations.txt").values()
    assert values["relations_trans_mean"] == pytest.approx(0.0508, abs=5e-4)
    assert values["relations_trans_std"] == pytest.approx(0.0336, abs=5e-4)
    assert values["relations_rot_mean"] == pytest.approx(np.radians(1.38), abs=2e-3)


def test_relations_of_another_log_are_refused(tmp_path):
    (tmp_path / "trajectory.tum").write_bytes((DATA / "csail" / "slam_reference.tum").read_bytes())
    with pytest.raises(InputError, match="no two stamps lie within 1 s"):
        evaluate_run(tmp_path, relations=FR079 / "relations.txt")


@pytest.fixture(scope="module")
def wean_map(tmp_path_factory) -> Path:
    """The building's map as map_server has it: 1 is free, 0 a wall, -1 unknown."""
    folder = tmp_path_factory.mktemp("wean_map")
    text = gzip.decompress((WEAN / "wean.dat.gz").read_bytes()).decode()
    lines = text.split("global_map[0]")[1].splitlines()[1:]
    cells = np.array([line.split() for line in lines if line.strip()], dtype=float)
    grey = np.where(cells < 0, 205, np.round(255 * cells)).astype(np.uint8)
    Image.fromarray(grey.T[::-1]).save(folder / "wean.pgm")
    (folder / "wean.yaml").write_text(
        "image: wean.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return folder / "wean.yaml"


@pytest.fixture(scope="module")
def wean_runs(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("wean_runs")
    for i in range(1, 6):
        run_log([WEAN / f"robotdata{i}.log.gz"], Config(), folder / f"wean{i}")
    return sorted(folder.iterdir())


@pytest.mark.slow
def test_wean_runs_are_found_on_the_map_of_wean_hall(wean_runs, wean_map):
    agreement = [
        evaluate_run(run, reference=wean_map).values().get("occupancy_agreement")
        for run in wean_runs
    ]
    assert sum(value is not None for value in agreement) >= 4
    assert all(value > 0.8 for value in agreement if value is not None)


@pytest.mark.slow
def test_wean_runs_are_refused_by_the_map_of_fr079(wean_runs):
    for run in wean_runs:
        document = evaluate_run(run, reference=FR079 / "reference.json")
        assert document.details["alignment"]["pose"] is None, run.name
        assert "area_recall" not in document.values()
