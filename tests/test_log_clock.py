"""One time for all records: the clock is chosen, broken stamps are mended and counted."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from hiermap_cli.logs.clock import ORDER_STEP, choose_clock, in_time_order, settle
from hiermap_cli.logs.records import LaserGeometry, Odometry, Record, Scan

SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("pairs", "clock"),
    [
        ([(1, 0), (2, 0), (3, 0)], "header"),
        ([(5, 5)], "header"),
        ([(0, 5)], "log"),
        ([(7, 1), (7, 2), (7, 3)], "log"),
        ([(9, 1), (8, 2), (7, 3)], "log"),
        ([(0, 0), (0, 0), (0, 0)], "order"),
        ([(1, 1), (1, 1), (2, 2), (2, 2)], "header"),
        ([(1, 1), (1, 2), (1, 3), (1, 4), (2, 5)], "log"),
        ([(3, 1), (2, 2), (1, 3), (2, 4)], "log"),
    ],
)
def test_the_clock_is_chosen_from_the_first_stamps(pairs, clock):
    assert choose_clock(pairs) == clock


GEOMETRY = LaserGeometry(0.0, 0.1, 1, 0.0, 10.0)


def scan(stamp_ns, log_ns=0):
    return Record("s", log_ns, Scan(stamp_ns, np.ones(1, dtype=np.float32), GEOMETRY))


def reading(stamp_ns, log_ns=0):
    return Record("o", log_ns, Odometry(stamp_ns, 0.0, 0.0, 0.0))


def settled(records, clock="header"):
    counts = Counter()
    out = list(in_time_order(settle(records, clock, counts), counts))
    times = [t.time_ns for t in out]
    assert times == sorted(times)
    return times, dict(counts)


def test_good_stamps_stay_as_they_are():
    stamps = [i * SECOND // 3 for i in range(50)]
    assert settled([scan(t) for t in stamps]) == (stamps, {})


def test_records_that_come_a_little_late_are_put_in_order():
    stamps = [0, 3, 1, 2, 6, 5, 4]
    tenth = SECOND // 10
    assert settled([scan(t * tenth) for t in stamps]) == ([t * tenth for t in range(7)], {})


def test_a_clock_that_is_set_back_is_carried_on():
    before = [i * SECOND for i in range(100, 130)]
    after = [i * SECOND for i in range(10, 40)]
    log = [i * SECOND for i in range(60)]
    records = [scan(t, w) for t, w in zip(before + after, log, strict=True)]
    times, counts = settled(records)
    assert times == [i * SECOND for i in range(100, 160)]
    assert counts["clock_set_back"] == 1


@pytest.mark.parametrize("wrong", [0, 5000 * SECOND, -SECOND])
def test_a_single_stamp_that_is_nonsense_takes_the_one_before(wrong):
    stamps = [i * SECOND for i in range(100, 140)]
    broken = [*stamps[:20], wrong, *stamps[21:]]
    times, counts = settled([scan(t) for t in broken])
    assert times == [*stamps[:20], stamps[19], *stamps[21:]]
    assert counts == {"stamp_outlier": 1}


def test_a_first_stamp_that_is_nonsense_is_replaced():
    stamps = [0, *(i * SECOND for i in range(9000, 9040))]
    times, counts = settled([scan(t) for t in stamps])
    assert min(times) >= 9000 * SECOND
    assert counts == {"stamp_outlier": 1}


def test_an_odometry_reading_with_a_stamp_that_is_nonsense_is_left_out():
    stamps = [i * SECOND for i in range(100, 140)]
    records = [reading(t) for t in stamps]
    records[10] = reading(0)
    times, counts = settled(records)
    assert times == stamps[:10] + stamps[11:]
    assert counts == {"odometry_stamp_outlier": 1}


def test_a_long_pause_is_no_fault():
    stamps = [*range(20), *range(5000, 5020)]
    assert settled([scan(t * SECOND) for t in stamps]) == ([t * SECOND for t in stamps], {})


def test_without_any_stamps_order_is_time_and_a_line_is_one_moment():
    records = [r for _ in range(5) for r in (reading(0), reading(0), scan(0))]
    times, _ = settled(records, "order")
    assert times == [k * ORDER_STEP for k in (0, 1, 1, 2, 3, 3, 4, 5, 5, 6, 7, 7, 8, 9, 9)]


def test_many_equal_stamps_do_not_pile_up():
    counts = Counter()
    stuck = (scan(5 * SECOND) for _ in range(20000))
    flow = in_time_order(settle(stuck, "header", counts), counts)
    assert sum(1 for _ in flow) == 20000
