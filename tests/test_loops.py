"""Loops of a whole log: found where the robot comes back, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loop_cases import blank_corridor, comb, drive_of, twins

from hiermap_cli.config import Config
from hiermap_cli.estimation.noise import NoiseScale
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.loops.chain import steps_of
from hiermap_cli.mapping.loops.closing import close_loops

WRONG = 0.4  # metres by which a wrong loop is off; the places that look alike are 3 m apart


def closed(drive):
    return close_loops(drive.keyscans, drive.poses, Config(), NoiseScale())


def kinds(result):
    return [event.kind for event in result.events]


def wrong_loops(drive, result):
    errors = [drive.relation_error(e.key_i, e.key_j, e.R_i_j) for e in result.edges]
    return [e for e in errors if np.hypot(e[0], e[1]) > WRONG or abs(e[2]) > 0.1]


@pytest.fixture(scope="module")
def rooms():
    return comb(6, 4.0, alike=False)


@pytest.fixture(scope="module")
def drifted(rooms):
    return drive_of(rooms, scale=0.01, curvature=0.001)


@pytest.fixture(scope="module")
def result(drifted):
    return closed(drifted)


def test_loops_take_the_drift_off(drifted, result):
    assert drifted.position_errors(drifted.poses).max() > 1.0
    assert drifted.position_errors(result.poses).max() < 0.25
    assert len(result.edges) >= 15
    assert not wrong_loops(drifted, result)


def test_the_covariances_of_loops_hold_their_errors(drifted, result):
    for edge in result.edges:
        true = se2.between(drifted.truth[edge.key_i], drifted.truth[edge.key_j])
        error = se2.log(se2.compose(true, se2.invert(edge.R_i_j)))
        assert error @ np.linalg.solve(edge.covariance, error) < 16.3  # 99.9 %, 3 degrees


def test_every_loop_is_told_with_its_figures(drifted, result):
    told = [event for event in result.events if event.kind == "loop_closed"]
    assert len(told) == len(result.edges)
    for event, edge in zip(told, result.edges, strict=True):
        assert event.stamp_ns == drifted.keyscans.stamps_ns[edge.key_j]
        assert event.details["to"] < event.stamp_ns * 1e-9
        assert event.details["overlap"] == edge.figures.overlap >= Config().loops.min_overlap
        assert edge.figures.crossing < Config().loops.max_crossing


def test_neighbouring_key_scans_do_not_jump_apart(drifted, result):
    before = se2.between(drifted.poses[:-1], drifted.poses[1:])
    after = se2.between(result.poses[:-1], result.poses[1:])
    off = se2.between(before, after)
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.03
    assert np.abs(off[:, 2]).max() < 0.02


def test_the_same_every_time(drifted, result):
    again = closed(drifted)
    assert again.poses.tobytes() == result.poses.tobytes()
    assert again.events == result.events


def test_what_needs_no_correction_is_left_alone(rooms):
    drive = drive_of(rooms)
    result = closed(drive)
    assert result.edges
    assert drive.position_errors(result.poses).max() < 0.02


def test_a_step_that_the_filter_got_wrong_is_put_right(rooms):
    sound = drive_of(rooms)
    k = len(sound.truth) // 2
    drive = drive_of(rooms, faults={k: np.array([0.5, -0.2, 0.25])})
    assert drive.position_errors(drive.poses).max() > 3.0
    result = closed(drive)
    assert not wrong_loops(drive, result)
    assert drive.position_errors(result.poses).max() < 0.3


@pytest.mark.parametrize("shown", [0, 1, 4])
def test_a_step_to_a_scan_that_knows_no_wall_is_broken(rooms, shown):
    """However well the filter has gone where the odometry led: nothing but that led there."""
    drive = drive_of(rooms)
    k = len(drive.poses) // 2
    s = drive.keyscans.segments
    at = np.flatnonzero(s.scan == k)
    assert len(at) >= max(shown, 1)
    sound = steps_of(drive.keyscans, drive.poses, Config(), NoiseScale())
    for kept in (0, 1):  # walls that the scan knew, of those that it shows
        wall = s.wall.copy()
        wall[at[kept:]] = -1
        seen = np.ones(len(wall), dtype=bool)
        seen[at[max(shown, kept) :]] = False
        segments = type(s)._make(column[seen] for column in s._replace(wall=wall))
        keyscans = drive.keyscans._replace(segments=segments)
        steps = steps_of(keyscans, drive.poses, Config(), NoiseScale())
        assert np.flatnonzero(steps.broken & ~sound.broken).tolist() == ([] if kept else [k])
        assert (np.trace(steps.covariance[k]) > np.trace(sound.covariance[k])) == (kept == 0)


def test_a_turn_told_wrongly_where_one_unknown_wall_is_seen_is_found(rooms):
    """Only the odometry leads to such a scan, and it lies: loops put it right there."""
    sound = drive_of(rooms)
    k = len(sound.truth) // 2
    drive = drive_of(rooms, faults={k: np.array([0.0, 0.0, 0.25])})
    s, told = drive.keyscans.segments, drive.keyscans.increments.copy()
    told[k] = se2.between(drive.poses[k - 1], drive.poses[k])
    at = np.flatnonzero(s.scan == k)
    wall, seen = s.wall.copy(), np.ones(len(s.wall), dtype=bool)
    wall[at], seen[at[1:]] = -1, False
    segments = type(s)._make(column[seen] for column in s._replace(wall=wall))
    keyscans = drive.keyscans._replace(
        increments=told, trusted=np.ones(len(told), dtype=bool), segments=segments
    )
    drive = replace(drive, keyscans=keyscans)
    result = closed(drive)
    assert not wrong_loops(drive, result)
    assert drive.position_errors(drive.poses).max() > 1.0
    assert drive.position_errors(result.poses).max() < 0.3


@pytest.mark.parametrize(
    ("scale", "curvature"), [(0.0, 0.0), (0.01, 0.001), (-0.02, 0.002), (0.04, 0.004)]
)
def test_rooms_that_are_all_alike_are_not_taken_for_each_other(scale, curvature):
    drive = drive_of(comb(6, 3.0), scale=scale, curvature=curvature)
    result = closed(drive)
    assert not wrong_loops(drive, result)
    before = drive.position_errors(drive.poses).max()
    assert drive.position_errors(result.poses).max() <= before + 0.05


@pytest.mark.parametrize("length", [30.0, 60.0, 100.0])
@pytest.mark.parametrize("scale", [0.0, 0.03])
def test_a_new_room_like_an_old_one_is_a_new_one(length, scale):
    drive = drive_of(twins(3.0, length), 1, scale=scale)
    result = closed(drive)
    assert not wrong_loops(drive, result)


@pytest.mark.parametrize("scale", [0.0, 0.02, 0.04])
def test_a_new_room_farther_off_than_is_searched_is_not_the_old_one(scale):
    faults = {77: np.array([0.3, -0.13, -0.04]), 79: np.array([-0.13, 0.14, -0.01])}
    drive = drive_of(twins(3.0, 100.0), 4, scale=scale, faults=faults)
    assert not wrong_loops(drive, closed(drive))
    # Where more is searched, the old room is in it, and looks as well as the new one.
    wide = Config().loops.model_copy(update={"max_shift": 12.0})
    config = Config().model_copy(update={"loops": wide})
    assert wrong_loops(drive, close_loops(drive.keyscans, drive.poses, config, NoiseScale()))


def test_a_twin_room_is_tempting():
    # Otherwise the test before would show nothing: without the gate on what is likely it is
    # taken for the other.
    bold = Config().loops.model_copy(update={"witness_gate": 11.3})
    drive = drive_of(twins(3.0, 100.0), 1)
    result = close_loops(
        drive.keyscans, drive.poses, Config().model_copy(update={"loops": bold}), NoiseScale()
    )
    assert wrong_loops(drive, result)


def test_a_corridor_of_parallel_walls_closes_nothing():
    drive = drive_of(blank_corridor(), scale=0.02)
    result = closed(drive)
    assert "loop_closed" not in kinds(result)
    assert np.array_equal(result.poses, drive.poses)


@pytest.mark.parametrize("keys", [1, 2, 5])
def test_hardly_any_log_is_no_fault(drifted, keys):
    k = drifted.keyscans
    few = k.segments.scan < keys
    segments = type(k.segments)(*(column[few] for column in k.segments))
    short = k._replace(
        stamps_ns=k.stamps_ns[:keys], area=k.area[:keys], increments=k.increments[:keys],
        trusted=k.trusted[:keys], segments=segments,
    )  # fmt: skip
    result = close_loops(short, drifted.poses[:keys], Config(), NoiseScale())
    assert result.edges == ()
    assert np.allclose(result.poses, drifted.poses[:keys])


def test_scans_that_saw_nothing_are_no_fault(drifted):
    k = drifted.keyscans
    none = np.zeros(len(k.segments.scan), dtype=bool)
    segments = type(k.segments)(*(column[none] for column in k.segments))
    result = close_loops(k._replace(segments=segments), drifted.poses, Config(), NoiseScale())
    assert result.edges == ()
    assert np.allclose(result.poses, drifted.poses)
