"""Truth that is of a small part of the run only is said to be so, and no other."""

from __future__ import annotations

import numpy as np
import pytest

from hiermap_cli.documents.relations import Relations
from hiermap_cli.documents.tum import TimedPoses
from hiermap_cli.evaluation.judge import Given, Run, judge
from hiermap_cli.evaluation.pairing import relations_warning, trajectory_warning
from hiermap_cli.mapping.model import Trajectory

RUN_NS = np.arange(0, 1_000_000_000_000, 250_000_000)  # 4000 poses in 1000 s


def stamps(first: float, last: float, every: float):
    return np.round(np.arange(first, last, every) * 1e9).astype(np.int64)


@pytest.mark.parametrize(
    "true_ns",
    [
        RUN_NS,
        RUN_NS + 100_000_000,
        stamps(0, 5000, 0.1),  # of which the run is a part
        stamps(0, 1000, 3.0),  # fewer than the run's poses
        stamps(0, 1000, 9.0),
        stamps(200, 800, 0.1),
    ],
)
def test_truth_of_most_of_the_run_is_no_warning(true_ns):
    assert trajectory_warning("t.tum", RUN_NS, true_ns) is None


@pytest.mark.parametrize(
    ("true_ns", "said"),
    [
        (RUN_NS * 1000, "have a true pose near in time, and 5 of 4000 true poses are compared"),
        (stamps(960, 2000, 0.1), "only 162 of the run's 4000 poses (4 %) have a true pose near"),
        (stamps(400, 800, 0.1), "only 1604 of the run's 4000 poses (40 %)"),
    ],
)
def test_truth_of_little_of_the_run_is_a_warning_with_the_figure(true_ns, said):
    warning = trajectory_warning("t.tum", RUN_NS, true_ns)
    assert warning.startswith("t.tum: only ")
    assert said in warning
    assert "same log and clock, with stamps in seconds?" in warning


def test_a_run_with_holes_in_which_most_of_the_truth_lies_is_a_warning():
    run_ns = np.concatenate((stamps(0, 10, 0.01), stamps(990, 1000, 0.01)))
    warning = trajectory_warning("t.tum", run_ns, stamps(0, 1000, 1.0))
    assert warning.startswith("t.tum: of the 1000 true poses in the run's time only 21 (2 %)")


def relations_at(first, second):
    return Relations(first, second, np.zeros((len(first), 3)))


def test_relations_outside_the_run_are_a_warning_where_they_are_most():
    first = stamps(0, 900, 10)
    assert relations_warning("r.txt", RUN_NS, relations_at(first, first + 10**9)) is None
    warning = relations_warning("r.txt", RUN_NS, relations_at(first * 10, first * 10 + 10**9))
    assert warning.startswith("r.txt: only 10 of the 90 relations (11 %) lie in the run's time")


def test_the_warnings_stand_in_the_document():
    poses = np.column_stack((RUN_NS * 1e-9, np.zeros((len(RUN_NS), 2))))
    run = Run(Trajectory(RUN_NS, poses, np.zeros((0, 3, 3))))
    few = TimedPoses(RUN_NS * 1000, poses)
    far = relations_at(RUN_NS * 1000, RUN_NS * 1000 + 10**9)
    given = Given(truth=few, relations=far, names={"trajectory": "ms.tum", "relations": "ms.txt"})
    said = judge(run, given).document.warnings
    assert [one.split(":")[0] for one in said] == ["ms.tum", "ms.txt"]
    assert judge(run, Given(truth=TimedPoses(RUN_NS, poses))).document.warnings == ()
