from __future__ import annotations

import math

import numpy as np
import pytest
from real_data import DATA
from test_trajectory_metrics import SECOND, fr079

from hiermap_cli.documents.relations import Relations, read_relations
from hiermap_cli.evaluation.relations import relation_errors, relations_metrics

__all__ = ["fr079"]


def relations(*rows: tuple[float, float, float, float, float]) -> Relations:
    table = np.array(rows)
    stamps = np.rint(table[:, :2] * 1e9).astype(np.int64)
    return Relations(stamps[:, 0], stamps[:, 1], table[:, 2:])


# The robot goes 2 m along x in 2 s, turns left by 90 degrees on the spot, goes 1 m along y.
STAMPS = np.array([0, 2, 3, 4]) * SECOND
POSES = np.array(
    [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, math.pi / 2], [2.0, 1.0, math.pi / 2]]
)


def test_a_small_case_computed_by_hand() -> None:
    true = relations(
        (0.0, 2.0, 2.3, 0.4, 0.1),  # 0.5 m and 0.1 rad off
        (0.0, 1.0, 1.0, 0.0, 0.0),  # half way between two poses: exact
        (3.0, 4.0, 1.0, 0.0, -0.2),  # ahead of the robot, which looks along y; 0.2 rad off
    )
    result = relations_metrics(STAMPS, POSES, true)
    assert result.trans_mean == pytest.approx(0.5 / 3, abs=1e-12)
    assert result.trans_std == pytest.approx(0.5 * math.sqrt(2) / 3, abs=1e-12)
    assert result.rot_mean == pytest.approx(0.1, abs=1e-12)
    assert result.rot_std == pytest.approx(math.sqrt(0.02 / 3), abs=1e-12)
    assert (result.n, result.missing) == (3, 0)


def test_only_relations_of_less_than_the_span() -> None:
    true = relations((0.0, 2.0, 2.5, 0.0, 0.0), (0.0, 4.0, 2.0, 1.0, math.pi / 2))
    assert relations_metrics(STAMPS, POSES, true, max_span_s=4.0).trans_mean == pytest.approx(0.5)
    assert relations_metrics(STAMPS, POSES, true).n == 2


def test_a_stamp_without_a_pose_within_a_second_is_missing() -> None:
    true = relations((0.0, 5.0, 2.0, 1.0, math.pi / 2), (0.0, 5.1, 2.0, 1.0, 0.0))
    errors = relation_errors(STAMPS, POSES, true)
    assert errors.used.tolist() == [True, False]
    result = relations_metrics(STAMPS, POSES, true)
    assert (result.n, result.missing) == (1, 1)
    assert result.trans_mean == pytest.approx(0.0, abs=1e-12)
    none = relations_metrics(STAMPS, POSES, true.select(np.array([False, True])))
    assert [m.name for m in none.metrics()] == ["relations_missing"]


def test_names_and_units_of_the_metrics() -> None:
    figures = relations_metrics(STAMPS, POSES, relations((0, 1, 1, 0, 0))).metrics()
    assert [(m.name, m.units) for m in figures] == [
        ("relations_trans_mean", "m"),
        ("relations_trans_std", "m"),
        ("relations_rot_mean", "rad"),
        ("relations_rot_std", "rad"),
        ("relations_missing", "1"),
    ]


def test_published_figures_of_a_real_log(fr079) -> None:
    odometry, reference = fr079
    true = read_relations(DATA / "fr079" / "relations.txt")
    assert len(true.poses) == 1685
    slam = relations_metrics(*reference, true)
    assert slam.trans_mean == pytest.approx(0.0508, abs=1e-4)
    assert slam.trans_std == pytest.approx(0.0336, abs=1e-4)
    assert math.degrees(slam.rot_mean) == pytest.approx(1.38, abs=0.01)
    assert relations_metrics(*odometry, true).trans_mean == pytest.approx(5.0, abs=0.05)
    assert relations_metrics(*odometry, true, 10.0).trans_mean == pytest.approx(0.049, abs=5e-4)
    assert relations_metrics(*reference, true, 10.0).trans_mean == pytest.approx(0.043, abs=5e-4)
