from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from map_cases import R_t_g, exact_model, exact_trajectory, reference_map, true_path

from hiermap_cli.documents.tum import TimedPoses
from hiermap_cli.logs.records import LaserGeometry, Mount, ScanBlock

SCRIPTS = Path(__file__).parent / "real"


def load(name: str):
    """A script of the folder as a module, without running it."""
    spec = importlib.util.spec_from_file_location(f"real_{name}", SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


FIGURES = {
    "name": "some",
    "scans": 100,
    "milliseconds_a_scan": 0.512,
    "peak_megabytes": 80.2,
    "areas": 3,
    "doors": 2,
    "landmarks": {"corner_concave": 12, "door": 4},
    "sigma_median": 0.0123,
    "own": {"scans_processed": 90.0, "scans_matched": 88.0, "nis_mean": 1.02},
}
JUDGED = {
    **FIGURES,
    "name": "judged",
    "ate_rmse": {"odometry": 5.0, "filter": 0.5, "final": None},
    "relations": {
        track: {"trans_mean": 1.25, "rot_mean_deg": 2.0, "n": 9}
        for track in ("odometry", "filter", "final")
    },
    "areas_matched": {"matched": 8, "asked": 16, "f1": 0.61},
    "doors_matched": {"matched": 9, "asked": 16},
    "map": {"corner_precision": 1.0, "nees_landmarks": 0.9},
}


def test_the_table_has_a_row_a_run_and_names_its_faults() -> None:
    table = load("table")
    text = table.table([FIGURES, JUDGED, {"name": "broken", "fault": "it fell"}])
    head, first, second, fault = text.splitlines()
    assert head.split()[:3] == ["log", "scans", "used"]
    assert "cv:12 do:4" in first
    assert "0.51" in first
    assert "5.000/0.500/-" in second
    assert "1.250/1.250/1.250" in second
    assert "8/16" in second
    assert "9/16" in second
    assert "1.00/-" in second
    assert fault == "broken: FAILED: it fell"


def test_a_run_that_fails_is_told_with_its_reason() -> None:
    table = load("table")
    row = table.run("no such world")
    assert row["name"] == "no such world"
    assert "no such world" in row["fault"]


def test_all_runs_that_can_be_made_are_listed() -> None:
    runs = load("runs")
    names = runs.names()
    assert {"room", "room_corridor", "ring", "office"} <= set(names)
    assert ("fr079" in names) == runs.DATA.exists()


def square_scan(flipped: bool) -> ScanBlock:
    """One scan of four beams in a square of 2 m around a robot at its centre."""
    return ScanBlock(
        stamps_ns=np.array([0]),
        ranges=np.array([[1.0, 0.9, np.inf, np.nan]], dtype=np.float32),
        odometry=np.zeros((1, 3)),
        has_odometry=np.ones(1, dtype=bool),
        laser=LaserGeometry(0.0, np.pi / 2, 4, 0.0, 30.0),
        mount=Mount(0.1, 0.0, 0.0, flipped),
    )


@pytest.mark.parametrize(("flipped", "side"), [(False, 0.9), (True, -0.9)])
def test_drawn_points_are_where_the_laser_saw_them(flipped: bool, side: float) -> None:
    pytest.importorskip("matplotlib")
    draw = load("draw")
    track = TimedPoses(np.array([0]), np.array([[5.0, 1.0, np.pi / 2]]))
    points = draw.scan_points([square_scan(flipped)], track)
    assert points == pytest.approx(np.array([[5.0, 2.1], [5.0 - side, 1.1]]), abs=1e-6)


def test_a_drawing_of_everything(tmp_path) -> None:
    pytest.importorskip("matplotlib")
    draw = load("draw")
    trajectory = exact_trajectory()
    picture = draw.Picture(
        track=TimedPoses(trajectory.stamps_ns, trajectory.poses),
        model=exact_model(),
        reference=reference_map(),
        truth=true_path(),
        R_d_g=R_t_g,
        size=8.0,
    )
    draw.draw(picture, [square_scan(False)], tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
