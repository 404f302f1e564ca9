"""The refinement as a whole: on simulated worlds, against dense least squares, and its levels."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_refinement_problem import scene

from hiermap_cli.config import Config
from hiermap_cli.estimation.noise import NoiseScale
from hiermap_cli.evaluation.consistency import robot_nees
from hiermap_cli.evaluation.trajectory import ate
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import END, WALL
from hiermap_cli.mapping.filtering import run_filter
from hiermap_cli.mapping.keyscans import ScanSegments
from hiermap_cli.mapping.levels import compose_levels
from hiermap_cli.mapping.refinement.between import laid_on_walls
from hiermap_cli.mapping.refinement.matches import (
    Placed,
    components,
    fit_walls,
    match_segments,
    merge_walls,
)
from hiermap_cli.mapping.refinement.problem import Walls, layout
from hiermap_cli.mapping.refinement.refine import refine
from hiermap_cli.mapping.refinement.smoothing import assemble, smooth, structure
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import load_world

RING = Path(__file__).resolve().parents[1] / "datasets" / "ring.yaml"


@cache
def ring(seed: int):
    """The ring world gone through by the filter, and refined."""
    simulation = simulate(load_world(RING), np.random.default_rng(seed))
    mapper, _ = run_filter(simulation.blocks(), Config())
    levels = compose_levels(mapper)
    return simulation, mapper, levels, refine(mapper, levels)


@pytest.mark.parametrize("scans", [1, 2, 3, 5])
def test_a_log_of_a_few_scans_is_refined_without_a_wall_seen_twice(scans):
    simulation, _, _, _ = ring(1)
    mapper, _ = run_filter([next(simulation.blocks(scans))], Config())
    refined = refine(mapper, compose_levels(mapper))
    assert np.isfinite(refined.levels.trajectory.poses).all()


def error(trajectory, simulation) -> float:
    return ate(trajectory.stamps_ns, trajectory.poses, simulation.stamps_ns, simulation.truth).rmse


def test_the_solution_is_that_of_dense_least_squares():
    state, keyscans, noise, matched = scene(5, keys=60, walls=4)
    config = Config()
    where = layout(state)
    solution = smooth(state, keyscans, noise, matched, config, 1.0, last=True)
    pieces = assemble(
        where, structure(where, solution.terms), solution.terms, solution.state, config
    )
    H, g = np.zeros((where.size, where.size)), np.zeros(where.size)
    for piece in pieces:
        H[np.ix_(piece.columns, piece.columns)] += piece.H
        g[piece.columns] += piece.g
    by_terms = np.zeros_like(H)
    for t in solution.terms:
        for i in range(len(t.e)):
            J = np.zeros((t.e.shape[1], where.size))
            J[:, t.columns[i]] = t.J[i]
            by_terms += J.T @ t.information[i] @ J
    prior = H - by_terms
    np.testing.assert_allclose(prior, np.diag(np.diag(prior)), atol=1e-9 * np.abs(H).max())
    np.testing.assert_allclose(solution.factor.solve(), np.linalg.solve(H, g), atol=1e-7)
    C = solution.factor.covariance(np.eye(where.size), np.arange(where.size))
    np.testing.assert_allclose(C, np.linalg.inv(H), atol=1e-8)


def test_gauss_newton_ends_where_the_gradient_is_nothing():
    state, keyscans, noise, matched = scene(6, keys=40, walls=5)
    config = Config()
    refine_more = config.refine.model_copy(update={"steps": 12, "converged": 1e-12})
    config = config.model_copy(update={"refine": refine_more})
    solution = smooth(state, keyscans, noise, matched, config, 1.0, last=True)
    assert np.abs(solution.factor.solve()).max() < 1e-4


def test_the_refined_ring_is_better_than_the_filters_and_believable():
    before, after, nees = [], [], []
    for seed in range(3):
        simulation, _, levels, refined = ring(seed)
        before.append(error(levels.trajectory, simulation))
        after.append(error(refined.levels.trajectory, simulation))
        truth = simulation.stamps_ns, simulation.truth
        nees.append(robot_nees(refined.levels.trajectory, *truth).mean)
    assert np.mean(after) < np.mean(before)
    assert np.mean(after) < 0.0075
    assert 0.4 < np.mean(nees) < 1.7


def test_the_trajectory_is_composed_from_the_levels():
    """Robot in area, area in g: the last pose, and each area's robot in g."""
    _, mapper, _, refined = ring(0)
    levels = refined.levels
    np.testing.assert_allclose(levels.robot, levels.trajectory.poses[-1], atol=1e-12)
    keys = np.array(mapper.trail.key_at)
    keyscans = mapper.keyscans.taken()
    for i, V in enumerate(levels.maps):
        last = np.flatnonzero(keyscans.area == i)[-1]
        at = se2.compose(levels.frames[i], V.robot)
        # Where the log ends the robot is farther on than at the last key scan.
        scan = -1 if i == mapper.current else keys[last]
        np.testing.assert_allclose(se2.between(at, levels.trajectory.poses[scan]), 0.0, atol=1e-9)


def test_an_areas_covariance_is_the_marginal_of_the_whole():
    """The robot of the last area in g, by the levels: its area's frame and its place there."""
    _, _, _, refined = ring(0)
    levels = refined.levels
    for V in levels.maps:
        C = V.covariance
        assert np.abs(C - C.T).max() < 1e-12
        assert np.linalg.eigvalsh(C).min() > -1e-9 * np.abs(C).max()
    assert np.linalg.eigvalsh(levels.covariance).min() > -1e-12


def test_areas_keep_their_anchors_and_ends_stay_with_their_walls():
    _, mapper, _, refined = ring(0)
    for before, after in zip(mapper.areas, refined.areas, strict=True):
        f = after.features
        assert len(set(f.uid.tolist())) == len(f.uid)
        assert set(f.wall[f.kind == END].tolist()) <= set(f.uid[f.kind == WALL].tolist())
        anchors = before.features.uid[before.features.kind == 2]
        assert set(anchors.tolist()) <= set(f.uid.tolist())


def test_two_runs_are_the_same_to_the_byte():
    _simulation, mapper, levels, first = ring(1)
    again = refine(mapper, levels)
    assert first.levels.trajectory.poses.tobytes() == again.levels.trajectory.poses.tobytes()
    assert first.levels.covariance.tobytes() == again.levels.covariance.tobytes()


def lines(*rows) -> Walls:
    """Walls from x, y, theta and length, about their middles."""
    table = np.array(rows, dtype=float)
    return Walls(table[:, :3], -0.5 * table[:, 3], 0.5 * table[:, 3])


@pytest.mark.parametrize(
    ("other", "one"),
    [
        ((1.0, 0.04, 0.0, 2.0), True),  # the same line, overlapping
        ((1.0, 0.2, 0.0, 2.0), False),  # beside it
        ((1.0, 0.04, np.pi, 2.0), False),  # the other side of a thin wall
        ((1.0, 0.0, 0.3, 1.0), False),  # turned
        ((6.0, 0.0, 0.0, 2.0), False),  # in line, beyond a gap
    ],
)
def test_walls_are_one_where_they_lie_on_one_line_and_overlap(other, one):
    number = merge_walls(lines((0.0, 0.0, 0.0, 4.0), other), 1.0, Config().refine)
    assert (number[0] == number[1]) == one


def test_segments_go_to_the_nearest_wall_that_they_overlap():
    _state, keyscans, _, _ = scene(0, keys=1, walls=3)
    s = keyscans.segments
    walls = lines((0.0, 0.0, 0.0, 4.0), (0.0, 0.1, 0.0, 4.0), (9.0, 0.02, 0.0, 4.0))
    centre = np.array([[0.5, 0.03], [0.5, 0.08], [0.5, 1.0]])
    half = np.array([0.5, 0.0])
    where = Placed(centre, np.zeros(3), np.stack((centre - half, centre + half), axis=1))
    labels = match_segments(walls, where, s._replace(length=np.ones(3)), 1.0, Config().refine)
    np.testing.assert_array_equal(labels, [0, 1, -1])


def test_a_wall_is_fitted_through_its_segments():
    angle = 0.4
    t = np.array([np.cos(angle), np.sin(angle)])
    centre = np.array([-1.0, 0.5, 2.0])[:, None] * t + np.array([3.0, -2.0])
    where = Placed(
        centre, np.full(3, angle), np.stack((centre - 0.5 * t, centre + 0.5 * t), axis=1)
    )
    walls = fit_walls(where, np.array([0, 0, 0]), np.ones(3), 1)
    np.testing.assert_allclose(walls.poses[0, 2], angle)
    np.testing.assert_allclose(walls.hi[0] - walls.lo[0], 4.0)
    reached = walls.poses[0, :2] + walls.lo[0] * t
    np.testing.assert_allclose(reached, [3.0, -2.0] - 1.5 * t, atol=1e-12)


def test_scans_between_key_scans_are_laid_on_the_walls():
    """Poses that are thought to be off come back to where the walls have them."""
    state, keyscans, _, _ = scene(2, keys=12, walls=6)
    exact = se2.between(
        state.poses[keyscans.segments.scan], state.walls.poses[keyscans.segments.wall]
    )
    along = np.column_stack((np.cos(exact[:, 2]), np.sin(exact[:, 2])))
    segments = keyscans.segments._replace(
        centre=exact[:, :2] + 0.3 * along,
        theta=exact[:, 2],
        ends=np.stack((exact[:, :2] - 0.4 * along, exact[:, :2] + 0.9 * along), axis=1),
        length=np.full(len(exact), 1.3),
    )
    off = np.random.default_rng(1).normal(0.0, 0.01, state.poses.shape)
    bridge = np.broadcast_to(np.eye(3) * 0.03**2, (12, 3, 3))
    thought = se2.compose(state.poses, se2.exp(off))
    found, left = laid_on_walls(state, thought, bridge, segments, NoiseScale(), Config())
    before = np.abs(se2.log(se2.between(state.poses, thought))).mean()
    after = np.abs(se2.log(se2.between(state.poses, found))).mean()
    assert after < 0.5 * before
    assert (np.linalg.eigvalsh(bridge + 1e-4 * np.eye(3) - left) > 0.0).all()


def test_a_scan_without_walls_stays_where_it_was_thought_to_be():
    state, keyscans, _, _ = scene(2, keys=3, walls=2)
    nothing = ScanSegments._make(column[:0] for column in keyscans.segments)
    bridge = np.broadcast_to(np.eye(3) * 0.02**2, (3, 3, 3))
    found, left = laid_on_walls(state, state.poses, bridge, nothing, NoiseScale(), Config())
    np.testing.assert_allclose(found, state.poses, atol=1e-12)
    np.testing.assert_allclose(left, bridge + 1e-4 * np.eye(3), atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 30), st.lists(st.tuples(st.integers(0, 29), st.integers(0, 29)), max_size=40))
def test_components_are_what_edges_connect(n, edges):
    edges = [(a % n, b % n) for a, b in edges]
    i, j = np.array(edges, dtype=np.int64).reshape(-1, 2).T
    number = components(n, i, j)
    groups = [{k} for k in range(n)]
    for a, b in edges:
        one = next(g for g in groups if a in g)
        other = next(g for g in groups if b in g)
        if one is not other:
            one |= other
            groups.remove(other)
    for a in range(n):
        for b in range(n):
            together = any(a in g and b in g for g in groups)
            assert (number[a] == number[b]) == together
    assert set(number.tolist()) == set(range(len(groups)))
