"""The last metres of the path: what becomes of them when the robot has come otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from hiermap_cli.config import DoorConfig
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.topology.passages import PassageDetector
from hiermap_cli.mapping.topology.trace import APART, Trace
from hiermap_cli.perception.sight import Sight

STEP = 0.1
SIGHT = Sight(np.zeros(2), np.array([[1.0, 0.5], [1.0, -0.5], [-1.0, 0.5], [-1.0, -0.5]]))


def walked(poses, first=0):
    trace = Trace()
    for key, pose in enumerate(poses, first):
        trace.add(pose, STEP, SIGHT, key)
    return trace


def ahead(n, sign=1.0):
    return [np.array([sign * STEP * k, 0.0, 0.0]) for k in range(n)]


def kept(trace):
    return [np.array(column) for column in (trace.keys, trace.travelled, trace.poses)] + [
        np.concatenate(trace.ends), trace.way.since(0), np.array(trace.origins),
    ]  # fmt: skip


@pytest.mark.parametrize("last", [1, 4, 12])
def test_amended_it_is_as_if_the_robot_had_come_so(last):
    """Twelve key scans told ahead, the last of which went back; or all."""
    true = ahead(12 - last)
    at = true[-1] if true else np.zeros(3)
    true += [at - np.array([STEP * (k + 1), 0.0, 0.0]) for k in range(last)]
    trace, wanted = walked(ahead(12)), walked(true)
    since = trace.amend({key: true[key] for key in range(12 - last, 12)})
    for mine, theirs in zip(kept(trace), kept(wanted), strict=True):
        assert mine == pytest.approx(theirs)
    assert (trace.length, trace.fresh) == (wanted.length, wanted.fresh)
    if last < 12:
        assert since == trace.travelled[11 - last]
    else:
        assert since == trace.travelled[0] - APART


def test_what_was_taken_already_is_not_taken_again():
    trace = walked(ahead(12))
    assert len(trace.older(0.35)) == 8  # to a metre's third before the end
    trace.amend(dict(zip(range(6, 12), ahead(6), strict=True)))
    assert trace.fresh == 4
    assert len(trace.older(0.0)) == 3  # all but the last, which lies at the end itself


def test_a_scan_that_is_not_kept_amends_nothing():
    trace = walked(ahead(5))
    before = kept(trace)
    trace.add(np.array([0.41, 0.0, 0.0]), 0.01, SIGHT, 5)  # too near the one before
    assert trace.amend({5: np.array([0.39, 0.0, 0.0])}) == trace.length
    for mine, theirs in zip(kept(trace), before, strict=True):
        assert np.array_equal(mine, theirs)


def test_widths_of_a_path_that_was_none_are_taken_anew():
    """Along a corridor that widens: the detector goes back with the path."""
    detector, other = PassageDetector(DoorConfig()), PassageDetector(DoorConfig())
    told, true = ahead(30), ahead(20) + [np.array([1.9 - STEP * k, 0.0, 0.0]) for k in range(10)]
    trace, wanted = walked([]), walked([])
    for key in range(30):
        trace.add(told[key], STEP, SIGHT, key)
        wanted.add(true[key], STEP, SIGHT, key)
        detector.passed(trace)
        other.passed(wanted)
    detector.rewind(trace.amend({key: true[key] for key in range(20, 30)}))
    detector.passed(trace)
    assert detector.at == pytest.approx(other.at)
    since = int(np.searchsorted(detector.at, 2.0))
    way = [trace.at(s)[0] for s in detector.at[since:]]
    assert np.array(way) == pytest.approx(np.array([wanted.at(s)[0] for s in other.at[since:]]))
    assert np.array(detector.heading[since:]) == pytest.approx(np.array(other.heading[since:]))


def test_moved_it_can_still_be_amended():
    trace, R = walked(ahead(6)), np.array([1.0, 2.0, 0.7])
    trace.move(R)
    pose = se2.compose(R, np.array([0.3, 0.1, 0.2]))
    trace.amend({5: pose})
    assert trace.poses[-1] == pytest.approx(pose)
    assert trace.way.since(5)[0] == pytest.approx(pose[:2])
