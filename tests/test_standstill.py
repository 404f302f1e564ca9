"""Whether the robot stands where its odometry says so, and stretches of the log as events."""

from __future__ import annotations

import numpy as np

from hiermap_cli.config import OdometryFaultConfig
from hiermap_cli.mapping.odometry.standstill import BEAMS, WITNESSES, Standstill
from hiermap_cli.mapping.odometry.stretches import Stretches

HERE = np.array([1.0, 2.0, 0.3])
RANGES = np.linspace(1.0, 5.0, 2 * BEAMS)


def told(odometry, ranges):
    """What is said at each scan."""
    watch = Standstill(OdometryFaultConfig())
    return [watch.belied(o, r) for o, r in zip(odometry, ranges, strict=True)]


def test_a_robot_that_stands_is_believed():
    noise = np.random.default_rng(0).normal(0.0, 0.01, (20, len(RANGES)))
    assert not any(told([HERE] * 20, RANGES + noise))


def test_ranges_that_go_on_changing_belie_a_standstill():
    out = told([HERE] * 12, [RANGES + 0.1 * k for k in range(12)])
    assert not any(out[: WITNESSES + 1])
    assert all(out[WITNESSES + 2 :])


def test_odometry_that_comes_a_little_late_is_no_lie():
    shift = np.minimum(0.1 * np.arange(12), 0.2)  # the robot goes on for two scans
    assert not any(told([HERE] * 12, RANGES + shift[:, None]))


def test_a_robot_that_is_told_to_move_may():
    odometry = HERE + 0.1 * np.arange(12)[:, None] * np.array([1.0, 0.0, 0.0])
    assert not any(told(odometry, [RANGES + 0.1 * k for k in range(12)]))


def test_people_and_beams_without_return_are_no_motion():
    ranges = np.tile(RANGES, (12, 1))
    ranges[::2, : len(RANGES) // 8] = 0.5  # one eighth of the view, now and then
    ranges[1::2, -40:] = np.inf
    assert not any(told([HERE] * 12, ranges))
    assert not any(told([HERE] * 12, np.full((12, len(RANGES)), np.nan)))


def test_a_stretch_is_one_event_with_its_begin_and_end():
    events = []
    stretches = Stretches(events)
    stretches.begin("odometry_missing", 2_000_000_000, 3_000_000_000, area="A1")
    stretches.begin("odometry_missing", 3_000_000_000, 4_500_000_000, area="A1")
    stretches.end("odometry_missing")
    stretches.end("odometry_missing")  # nothing is open
    stretches.begin("odometry_missing", 9_000_000_000, 9_000_000_000, area="A2")
    assert [event.stamp_ns for event in events] == [2_000_000_000, 9_000_000_000]
    assert events[0].details == {"area": "A1", "begin": 2.0, "end": 4.5}
    stretches.end("odometry_missing", 1_000_000_000)  # an end is never before the begin
    assert events[1].details == {"area": "A2", "begin": 9.0, "end": 9.0}
