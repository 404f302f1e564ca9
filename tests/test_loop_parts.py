"""The parts of loop closing: fragments, the chain, the graph, and the judging of witnesses."""

from __future__ import annotations

import numpy as np
import pytest
from loop_cases import blank_corridor, comb, drive_of

from hiermap_cli.config import Config
from hiermap_cli.estimation.motion import distrusted, motion
from hiermap_cli.estimation.noise import NoiseScale
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.loops.candidates import candidates, near_pairs, nothing_asked
from hiermap_cli.mapping.loops.chain import broken_between, carried, chain, step_noise, steps_of
from hiermap_cli.mapping.loops.correspondences import Candidates, ragged
from hiermap_cli.mapping.loops.fragments import cut_path, fragments_of
from hiermap_cli.mapping.loops.graph import (
    Edges,
    chi2,
    discrepancy,
    joined,
    moved,
    no_edges,
    solved,
    ways,
)
from hiermap_cli.mapping.loops.matching import match
from hiermap_cli.mapping.loops.sight import crossing_share, sights_of

LOOPS = Config().loops


@pytest.fixture(scope="module")
def drive():
    return drive_of(comb(4, 4.0, alike=False), scale=0.01)


@pytest.fixture(scope="module")
def parts(drive):
    steps = steps_of(drive.keyscans, drive.poses, Config(), NoiseScale())
    fragments = fragments_of(drive.keyscans, drive.poses, steps.broken, LOOPS)
    return steps, fragments, chain(fragments, drive.poses, steps, Config(), NoiseScale())


# --- fragments ---


def test_fragments_are_about_as_long_as_asked_for(drive, parts):
    _, fragments, _ = parts
    path = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(drive.poses[:, :2], axis=0).T))))
    length = np.diff(path[np.minimum(fragments.first, len(path) - 1)])
    assert length.min() > 0.6 * LOOPS.fragment_path
    assert length.max() < 1.5 * LOOPS.fragment_path


def test_fragments_end_at_broken_steps_but_not_at_every_one_of_a_row(drive):
    broken = np.zeros(len(drive.poses), dtype=bool)
    broken[[50, 51, 52, 53, 90]] = True
    first = cut_path(drive.poses, broken, LOOPS)
    assert 50 in first
    assert 90 in first
    assert not {51, 52, 53} & set(first.tolist())


def test_walls_of_a_fragment_lie_where_the_building_has_them():
    # Of a corridor 2 m wide with walls 15 cm thick the robot sees what is in between.
    drive = drive_of(blank_corridor())
    none = np.zeros(len(drive.poses), dtype=bool)
    fragments = fragments_of(drive.keyscans, drive.poses, none, LOOPS)
    walls = fragments.walls
    assert len(np.unique(walls.fragment)) == len(fragments.centre)
    middle = 0.5 * (walls.lo + walls.hi)
    direction = np.column_stack((walls.normal[:, 1], -walls.normal[:, 0]))
    at = walls.normal * walls.offset[:, None] + direction * middle[:, None]
    frame = drive.poses[fragments.centre][walls.fragment]
    y = se2.compose(frame, np.column_stack((at, walls.theta)))[:, 1]
    assert np.abs(np.abs(y - 1.0) - 0.925).max() < 0.02
    # The free side is on the left: the normal shows into the corridor.
    inwards = se2.compose(frame, np.column_stack((at + 0.1 * walls.normal, walls.theta)))[:, 1]
    assert (np.abs(inwards - 1.0) < np.abs(y - 1.0)).all()


# --- the chain ---


def test_the_noise_of_many_steps_is_that_of_the_motion_model(drive):
    Q = step_noise(drive.keyscans, Config(), NoiseScale(odometry=0.7))
    for k in range(1, 40):
        one = motion(drive.keyscans.increments[k], np.zeros(4), Config().odometry)
        assert np.allclose(Q[k], 0.7 * one.covariance)


def test_a_step_that_is_not_trusted_is_as_uncertain_as_a_distrusted_motion(drive):
    untrusted = drive.keyscans.trusted.copy()
    untrusted[30] = False
    keyscans = drive.keyscans._replace(trusted=untrusted)
    steps = steps_of(keyscans, drive.poses, Config(), NoiseScale())
    assert np.flatnonzero(steps.broken).tolist() == [30]
    one = motion(keyscans.increments[30], np.zeros(4), Config().odometry)
    assert np.allclose(steps.covariance[30], distrusted(one, Config().odometry).covariance)


def test_where_the_filter_leaves_the_odometry_the_step_is_broken(drive):
    poses = drive.poses.copy()
    poses[40:] = se2.compose(
        se2.compose(poses[39], np.array([0.6, 0.0, 0.3])), se2.between(poses[39], poses[40:])
    )
    steps = steps_of(drive.keyscans, poses, Config(), NoiseScale())
    assert np.flatnonzero(steps.broken).tolist() == [40]


def test_a_filter_that_has_leapt_may_be_wrong_by_as_much(drive):
    k = 40
    poses = drive.poses.copy()
    leap = np.array([6.0, -3.0, 2.0])
    poses[k:] = se2.compose(se2.compose(poses[k - 1], leap), se2.between(poses[k - 1], poses[k:]))
    steps = steps_of(drive.keyscans, poses, Config(), NoiseScale())
    assert np.flatnonzero(steps.leapt).tolist() == [k]
    fragments = fragments_of(drive.keyscans, poses, steps.broken, LOOPS)
    edges = chain(fragments, poses, steps, Config(), NoiseScale())
    (over,) = np.flatnonzero((fragments.centre[:-1] < k) & (fragments.centre[1:] >= k))
    assert np.sqrt(edges.C_i_j[over, [0, 1, 2], [0, 1, 2]]).min() > 2.0
    others = np.delete(np.sqrt(edges.C_i_j[:, 2, 2]), over)
    assert others.max() < 0.3


def test_walls_that_both_see_hold_a_fragment_but_not_along_a_blank_corridor(parts):
    steps, fragments, edges = parts
    assert not broken_between(fragments, steps).any()
    with_walls = np.sqrt(edges.C_i_j[:, 2, 2])
    alone = np.sqrt(np.diff(np.cumsum(steps.covariance[:, 2, 2])[fragments.centre]))
    assert np.median(with_walls / alone) < 0.5
    blank = drive_of(blank_corridor())
    steps = steps_of(blank.keyscans, blank.poses, Config(), NoiseScale())
    fragments = fragments_of(blank.keyscans, blank.poses, steps.broken, LOOPS)
    C = chain(fragments, blank.poses, steps, Config(), NoiseScale()).C_i_j[0]
    assert C[0, 0] > 4.0 * C[1, 1]


def test_frames_left_as_they_are_leave_the_key_poses(drive, parts):
    steps, fragments, _ = parts
    frames = drive.poses[fragments.centre]
    same = carried(fragments, drive.poses, frames, steps.covariance)
    assert np.allclose(same, drive.poses, atol=1e-12)


def test_frames_that_move_take_their_key_scans_along_without_a_jump(drive, parts):
    steps, fragments, _ = parts
    frames = drive.poses[fragments.centre].copy()
    frames[3:] = se2.compose(np.array([0.3, 0.1, 0.05]), frames[3:])
    poses = carried(fragments, drive.poses, frames, steps.covariance)
    assert np.allclose(poses[fragments.centre], frames, atol=1e-12)
    first, last = fragments.centre[2], fragments.centre[3]
    assert np.allclose(poses[: first + 1], drive.poses[: first + 1], atol=1e-12)
    off = se2.between(
        se2.between(drive.poses[:-1], drive.poses[1:]), se2.between(poses[:-1], poses[1:])
    )
    size = np.hypot(off[:, 0], off[:, 1])
    assert size[:first].max() < 1e-9
    assert size[first:last].max() < 0.3 * 0.5
    assert size[last:].max() < 1e-9


# --- what was seen through ---


def test_no_fragment_has_seen_through_its_own_walls(parts):
    _, fragments, _ = parts
    sights = sights_of(fragments, LOOPS)
    k = np.arange(len(fragments.centre))
    share = crossing_share(fragments, sights, k, k, np.zeros((len(k), 3)), LOOPS)
    assert share.max() < 0.03


def test_a_fragment_half_a_room_off_has_seen_through_walls(parts):
    _, fragments, _ = parts
    sights = sights_of(fragments, LOOPS)
    k = np.arange(len(fragments.centre))
    for off in ((2.0, 0.0, 0.0), (0.0, -1.5, 0.3)):
        there = np.tile(np.array(off), (len(k), 1))
        share = crossing_share(fragments, sights, k, k, there, LOOPS)
        assert np.median(share) > 0.2


# --- the graph ---


def ring(n, drift):
    """A ring of n fragments a metre apart, its steps falsely turned by `drift`, and the closure."""
    step = np.array([1.0, 0.0, 2.0 * np.pi / n])
    C = np.diag([0.01, 0.01, 0.001])
    truth = [np.zeros(3)]
    for _ in range(n - 1):
        truth.append(se2.compose(truth[-1], step))
    truth = np.array(truth)
    frames = [np.zeros(3)]
    for _ in range(n - 1):
        frames.append(se2.compose(frames[-1], step + np.array([0.0, 0.0, drift])))
    frames = np.array(frames)
    i = np.arange(n - 1)
    path = Edges(i, i + 1, se2.between(frames[:-1], frames[1:]), np.repeat(C[None], n - 1, axis=0))
    closure = Edges(
        np.array([n - 1]), np.array([0]), se2.between(truth[-1:], truth[:1]), 0.01 * C[None]
    )
    return truth, frames, path, closure


def test_a_ring_is_closed_and_its_error_spread():
    truth, frames, path, closure = ring(24, 0.01)
    edges = joined((path, closure))
    robust = np.zeros(len(edges.i), dtype=bool)
    before = np.hypot(*discrepancy(frames, closure)[0, :2])
    after = solved(frames, edges, robust, 3.0)
    assert before > 0.5
    assert np.hypot(*discrepancy(after, closure)[0, :2]) < 0.02
    assert np.hypot(*(after - truth)[:, :2].T).max() < 0.1
    # All steps take the same share.
    turned = se2.between(path.R_i_j, se2.between(after[:-1], after[1:]))[:, 2]
    assert np.ptp(turned) < 0.002


def test_frames_that_fit_already_stay():
    truth, _, path, closure = ring(12, 0.0)
    edges = joined((path, closure))
    after = solved(truth, edges, np.ones(len(edges.i), dtype=bool), 3.0)
    assert np.allclose(after, truth, atol=1e-9)
    assert chi2(after, edges).max() < 1e-12


def test_one_false_loop_against_many_true_ones_does_not_bend_them():
    truth, frames, path, closure = ring(24, 0.004)
    true = Edges(
        np.array([22, 21, 20]), np.array([1, 2, 3]),
        se2.between(truth[[22, 21, 20]], truth[[1, 2, 3]]), 0.01 * path.C_i_j[:3],
    )  # fmt: skip
    false = Edges(np.array([18]), np.array([4]), np.array([[3.0, 0.0, 0.0]]), 0.01 * path.C_i_j[:1])
    edges = joined((path, closure, true, false))
    robust = np.arange(len(edges.i)) >= len(path.i)
    after = solved(frames, edges, robust, 3.0)
    assert np.hypot(*(after - truth)[:, :2].T).max() < 0.15
    assert chi2(after, false)[0] > 1000.0


def test_the_covariance_of_a_way_is_that_of_its_steps():
    _, frames, path, _ = ring(20, 0.003)
    net = ways(frames, path)
    for i, j in ((0, 19), (3, 11), (11, 3), (7, 8), (5, 5)):
        C = np.zeros((3, 3))
        for k in range(min(i, j), max(i, j)):
            C += moved(path.C_i_j[k], se2.compose(se2.invert(frames[i]), frames[k]))
        found = net.relative(np.array([i]), np.array([j]))[0]
        assert np.allclose(found, C, atol=1e-12)


def test_a_loop_makes_the_way_shorter():
    _, frames, path, closure = ring(40, 0.0)
    far = np.array([0]), np.array([37])
    before = ways(frames, path).relative(*far)[0]
    after = ways(frames, joined((path, closure))).relative(*far)[0]
    assert np.linalg.eigvalsh(before - after).min() > -1e-9
    assert np.trace(after) < 0.3 * np.trace(before)


# --- candidates and matching ---


def test_pairs_of_near_points_are_all_of_them():
    points = np.random.default_rng(5).uniform(-30.0, 30.0, (120, 2))
    i, j = near_pairs(points, 7.0)
    found = set(zip(i.tolist(), j.tolist(), strict=True))
    assert len(found) == len(i)
    far = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    assert found == {(a, b) for a in range(120) for b in range(a + 1, 120) if far[a, b] < 7.0}


def test_a_ragged_table_laid_flat():
    whose, row = ragged(np.array([2, 0, 3]))
    assert whose.tolist() == [0, 0, 2, 2, 2]
    assert row.tolist() == [0, 1, 0, 1, 2]


def test_nothing_is_asked_twice_unless_more_is_known(parts):
    steps, fragments, path = parts
    net = ways(fragments_frames(parts), path)
    broken = broken_between(fragments, steps)
    first = candidates(fragments, net, no_edges(), broken, LOOPS)
    assert len(first.i)
    assert (first.j - first.i > LOOPS.least_steps).all()
    asked = nothing_asked().joined(first)
    assert not len(asked.news(first, LOOPS).i)
    better = first._replace(C_i_j=0.25 * first.C_i_j)
    assert len(asked.news(better, LOOPS).i) == len(first.i)


def fragments_frames(parts):
    _, fragments, path = parts
    frames = [np.zeros(3)]
    for R in path.R_i_j:
        frames.append(se2.compose(frames[-1], R))
    assert len(frames) == len(fragments.centre)
    return np.array(frames)


def test_a_fragment_is_found_on_its_own_walls_from_a_false_prior(parts):
    _, fragments, _ = parts
    k = np.arange(len(fragments.centre))
    off = np.tile(np.array([0.5, -0.4, 0.08]), (len(k), 1))
    C = np.repeat(np.diag([0.2, 0.2, 0.01])[None], len(k), axis=0)
    found = match(fragments, Candidates(k, k, off, C), LOOPS)
    sure = (found.evidence.cross > 2.0) & (found.second < 0.8)
    assert sure.sum() >= 5
    assert np.abs(found.R_i_j[sure]).max() < 0.02
