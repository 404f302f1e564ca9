"""Ranges, stamps, and the joining of scans with odometry."""

from __future__ import annotations

import math
from collections import Counter
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiermap_cli.geometry.se2 import interpolate
from hiermap_cli.logs import join as joining
from hiermap_cli.logs.clock import Timed
from hiermap_cli.logs.container import Channel, Message, Piece, in_log_order
from hiermap_cli.logs.decimals import ns_to_seconds, seconds_to_ns
from hiermap_cli.logs.gaps import Intervals
from hiermap_cli.logs.join import in_blocks, join
from hiermap_cli.logs.ranges import SICK_FIRST_CODE, float32, infer_range_max, translate
from hiermap_cli.logs.raw import RawScan, finish, stated
from hiermap_cli.logs.records import LaserGeometry, Mount, Odometry, Scan

SECOND = 1_000_000_000
INF, NAN = math.inf, math.nan

# ------------------------------------------------------------------------ stamps


@given(st.integers(0, 4_000_000_000), st.integers(0, 999_999))
def test_stamps_of_six_decimals_are_exact(seconds, micros):
    text = f"{seconds}.{micros:06d}"
    assert seconds_to_ns(text) == seconds * SECOND + micros * 1000
    assert seconds_to_ns(text.encode()) == seconds_to_ns(text)


@given(st.decimals(min_value=-4_000_000_000, max_value=4_000_000_000, places=9))
def test_stamps_go_to_text_and_back(value):
    stamp = int(value.scaleb(9))
    assert seconds_to_ns(ns_to_seconds(stamp)) == stamp
    assert Decimal(ns_to_seconds(stamp)) == value


@pytest.mark.parametrize(
    ("text", "stamp"),
    [("1e-3", 10**6), ("-2.5", -25 * 10**8), (".5", 5 * 10**8), ("3", 3 * SECOND), ("1.", SECOND)],
)
def test_stamps_in_other_spellings(text, stamp):
    assert seconds_to_ns(text) == stamp


@pytest.mark.parametrize("text", ["", "nan", "inf", "1.2.3", "host", "1e300", "-", "9" * 30, "1_0"])
def test_what_is_no_stamp_is_refused(text):
    with pytest.raises(ValueError, match="stamp"):
        seconds_to_ns(text)


# ------------------------------------------------------------------------ ranges


def test_every_convention_of_no_return_becomes_inf_or_nan():
    values = np.float32([1.0, 0.05, 0.1, 29.99, 30.0, 31.0, INF, NAN, 0.0, -1.0, -INF])
    out = translate(values, float32(0.1), float32(30.0))
    expected = np.float32([1.0, NAN, 0.1, 29.99, INF, INF, INF, NAN, NAN, NAN, NAN])
    np.testing.assert_array_equal(out, expected)
    assert values[3] == np.float32(29.99), "the input is not changed"


@given(st.lists(st.floats(width=32), max_size=30))
def test_translating_twice_changes_nothing(values):
    once = translate(np.array(values, dtype=np.float32), float32(0.1), float32(30.0))
    np.testing.assert_array_equal(translate(once, float32(0.1), float32(30.0)), once)


def head(*values, repeat=1):
    rng = np.random.default_rng(3)
    returns = rng.uniform(0.5, 9.0, 300).round(2)
    return [np.float32([*returns, *values]) for _ in range(repeat)]


@pytest.mark.parametrize(
    ("scans", "reach"),
    [
        (head(), SICK_FIRST_CODE),
        (head(81.91, repeat=3), SICK_FIRST_CODE),
        (head(81.83, 81.87, 81.9), SICK_FIRST_CODE),
        (head(50.0, repeat=5), 50.0),
        (head(50.0, repeat=1), SICK_FIRST_CODE),
        (head(32.767, repeat=1), SICK_FIRST_CODE),
        (head(32.767, 32.767, repeat=4), 32.767),
        (head(*[27.35] * 5, repeat=3), 27.35),
        (head(*[27.35] * 5, repeat=1), SICK_FIRST_CODE),
        (head(27.35, repeat=64), SICK_FIRST_CODE),
        ([np.full(50, 5.6, dtype=np.float32)] * 9, SICK_FIRST_CODE),
        ([np.full(50, 9.5, dtype=np.float32)] * 9, SICK_FIRST_CODE),
        (head(INF, NAN, 0.0, -1.0), SICK_FIRST_CODE),
        ([np.float32([NAN, INF, 0.0])], SICK_FIRST_CODE),
        ([], SICK_FIRST_CODE),
        ([100.0 * scan for scan in head()], 1e6),
    ],
)
def test_the_reach_is_found_where_a_laser_saturates(scans, reach):
    assert infer_range_max(scans) == float32(reach)


def test_a_stated_reach_counts_only_if_it_can_be_one():
    assert stated(0.1, 30.0) == 30.0
    for range_max in (0.0, -1.0, 0.05, INF, NAN):
        assert stated(0.1, range_max) is None


def test_a_geometry_holds_what_float32_holds():
    raw = RawScan(0, "l", np.float32([1, 2]), -math.pi / 2, math.pi / 180, 0.1, 81.83)
    laser = finish(raw, float32(1e6)).laser
    assert all(float(np.float32(value)) == value for value in laser)


# ----------------------------------------------------------------------- joining

LASER = LaserGeometry(-1.0, 0.5, 4, 0.0, 30.0)


def odo(seconds, x=0.0, y=0.0, theta=0.0):
    return Timed(round(seconds * SECOND), 0, Odometry(0, x, y, theta), 0, None)


def scan(seconds, own=None, laser=LASER, ranges=None):
    values = np.ones(laser.beams, dtype=np.float32) if ranges is None else np.float32(ranges)
    return Timed(round(seconds * SECOND), 0, Scan(0, values, laser), 0, own)


def joined(*records, first=None):
    counts = Counter()
    readings = [r.value for r in records if isinstance(r.value, Odometry)]
    out = list(join(records, first or readings[0], counts))
    return out, {k: v for k, v in counts.items() if k != "odometry"}


angle = st.floats(-7.0, 7.0)


@given(angle, angle, st.floats(0.0, 1.0))
def test_odometry_is_interpolated_as_poses_are(theta0, theta1, fraction):
    (out,), counts = joined(
        odo(1.0, 1.0, 2.0, theta0), scan(1.0 + fraction), odo(2.0, 3.0, 1.0, theta1)
    )
    turn = abs(math.remainder(theta1 - theta0, 2 * math.pi))
    if turn < math.pi - 1e-6:
        poses = np.array([[1.0, 2.0, theta0], [3.0, 1.0, theta1]])
        used = (out.time_ns - SECOND) / SECOND
        expected = interpolate(poses[0], poses[1], np.array(used))
        off = np.array(out.pose) - expected
        off[2] = math.remainder(off[2], 2 * math.pi)
        np.testing.assert_allclose(off, 0.0, atol=1e-9)
    assert -math.pi < out.pose[2] <= math.pi
    assert out.has_odometry
    assert counts == {}


def test_scans_around_the_odometry_come_out_too():
    out, counts = joined(scan(0.5), scan(0.8), odo(1.0, 1.0), odo(2.0, 2.0), scan(2.5), scan(3.0))
    assert [o.has_odometry for o in out] == [False, False, True, True]
    assert [o.pose[0] for o in out] == [1.0, 1.0, 2.0, 2.0]
    assert counts == {"before_first_odometry": 2, "after_last_odometry": 2}


def test_a_scan_at_the_first_or_last_reading_has_it():
    out, counts = joined(scan(1.0), odo(1.0, 4.0), odo(2.0, 5.0), scan(2.0))
    assert [(o.pose[0], o.has_odometry) for o in out] == [(4.0, True), (5.0, True)]
    assert counts == {}


def test_a_scans_own_reading_counts_before_all_others():
    own = Odometry(0, 9.0, 9.0, 0.5)
    out, _ = joined(odo(1.0), scan(1.5, own), odo(2.0), scan(2.5, own))
    assert [o.pose for o in out] == [(9.0, 9.0, 0.5)] * 2


@pytest.mark.parametrize("bad", [NAN, INF, 1e9])
def test_odometry_that_is_no_number_is_left_out_and_counted(bad):
    out, counts = joined(odo(1.0, 1.0), odo(1.4, bad), scan(1.5), odo(2.0, 2.0))
    assert out[0].pose == (1.5, 0.0, 0.0)
    assert counts == {"odometry_not_finite": 1}


def test_scans_do_not_wait_for_odometry_without_end(monkeypatch):
    monkeypatch.setattr(joining, "PENDING", 5)
    records = [odo(0.0, 1.0), *(scan(float(i)) for i in range(1, 20)), odo(20.0, 21.0)]
    flow = join(iter(records), records[0].value, counts := Counter())
    out = list(flow)
    assert [o.time_ns for o in out] == [i * SECOND for i in range(1, 20)]
    # The first fourteen were given away before the next reading came.
    assert [o.pose[0] for o in out[:14]] == [1.0] * 14
    assert [o.pose[0] for o in out[14:]] == [16.0, 17.0, 18.0, 19.0, 20.0]
    assert counts["odometry_missing"] == 14


def blocks(*records, size=256):
    counts = Counter()
    flow = join(records, Odometry(0, 0.0, 0.0, 0.0), counts)
    return list(in_blocks(flow, Mount(), LASER, size, counts)), counts


def test_a_change_of_beams_begins_a_new_block():
    other = LASER._replace(beams=5)
    out, counts = blocks(odo(0.0), scan(1.0), scan(2.0), scan(3.0, laser=other), scan(4.0))
    assert [(len(b), b.laser.beams) for b in out] == [(2, 4), (1, 5), (1, 4)]
    assert counts["scans"] == 4


def test_scans_that_say_nothing_are_kept_and_counted():
    empty = LASER._replace(beams=0)
    nowhere = LASER._replace(angle_increment=NAN)
    out, counts = blocks(
        odo(0.0), scan(1.0), scan(2.0, laser=empty, ranges=[]), scan(3.0, laser=nowhere),
        scan(4.0, ranges=[NAN] * 4), scan(5.0, ranges=[INF] * 4), scan(5.0),
    )  # fmt: skip
    (block,) = out
    assert len(block) == 6
    assert np.isnan(block.ranges[1:4]).all()
    assert counts["no_beams"] == 2
    assert counts["no_valid_range"] == 4
    assert counts["repeated_stamp"] == 1


def test_blocks_cannot_be_changed():
    (block,), _ = blocks(odo(0.0), scan(1.0))
    with pytest.raises(ValueError, match="read-only"):
        block.ranges[0] = 1.0


# --------------------------------------------------------------------- log order


def piece(times, loaded, label):
    def load():
        loaded.append(label)
        return [Message(t, Channel(label, "", ""), b"") for t in times]

    return Piece(min(times), max(times), load)


@given(st.lists(st.lists(st.integers(1, 50), min_size=1, max_size=6), max_size=8))
def test_messages_come_by_log_time_and_ties_by_place(rows):
    pieces = [piece(row, [], f"{i}") for i, row in enumerate(rows)]
    out = [(m.log_ns, m.channel.topic) for m in in_log_order(pieces)]
    flat = [(t, i, j) for i, row in enumerate(rows) for j, t in enumerate(row)]
    assert out == [(t, f"{i}") for t, i, _ in sorted(flat)]


def test_only_pieces_whose_times_overlap_are_in_memory_together():
    loaded = []
    pieces = [piece(range(10 * i + 1, 10 * i + 11), loaded, f"{i}") for i in range(9)]
    flow = in_log_order(pieces)
    for _ in range(25):
        next(flow)
    assert loaded == ["0", "1", "2"]


def test_gaps_stand_out():
    intervals = Intervals()
    stamps = np.cumsum(np.full(500, SECOND // 10))
    stamps[200:] += 7 * SECOND
    stamps[400:] += 3 * SECOND
    for part in np.array_split(stamps, 7):
        intervals.add(part.astype(np.int64))
    assert intervals.median() == pytest.approx(0.1, rel=0.05)
    assert [round(gap.seconds, 6) for gap in intervals.gaps()] == [7.1, 3.1]
    assert intervals.gaps()[0].at_ns == stamps[199]
