"""The three levels are the estimator: what is learnt of one landmark moves all that hangs on it.

A robot has driven through a simulated room. One wall of it is then said to lie elsewhere, by a
tight constraint on its pose alone, and the robot drives on, out by the door, through the corridor
and back in. The same drive without that constraint is what it is held against.
"""

from __future__ import annotations

import copy
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from estimation_cases import assembled, error_of, gain_of
from world_cases import DATASETS

from hiermap_cli.config import Config
from hiermap_cli.estimation.constraint import Constraint, constrain
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, END, WALL
from hiermap_cli.mapping.mapper import Mapper
from hiermap_cli.mapping.model import MapResult
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import load_world

HERE = 60  # scans until the constraint: the robot nears the door
SIGMAS = 1.0  # by how much of its own uncertainty the wall is moved
TOLD = 1e-8  # square metres, the variance of what is told


class Moved(NamedTuple):
    """An area before and after the constraint, the wall's index (from 0), and by how much it was
    moved across itself, in metres."""

    before: Mapper
    after: Mapper
    wall: int
    shift: float


def across(V, i):
    """d (offset of object i across itself, in its own frame) / d errors of V, (N,)."""
    row = np.zeros(len(V.covariance))
    Ad = se2.adjoint(se2.invert(V.poses[1 + i]))
    row[V.columns(1 + i)] = Ad[1]
    return row


@cache
def blocks():
    simulation = simulate(load_world(DATASETS / "room_corridor.yaml"), np.random.default_rng(1))
    return simulation, tuple(simulation.blocks(HERE))


@cache
def moved():
    before = Mapper(Config())
    before.take(blocks()[1][0])
    V, f = before.area.V, before.area.features
    P = V.covariance
    walls = np.flatnonzero((f.kind == WALL) & (f.seen > 5))
    rows = np.array([across(V, int(i)) for i in walls])
    spread = np.sqrt(np.einsum("ki,ij,kj->k", rows, P, rows))
    robot = np.hypot(*(rows @ P[:, :2]).T) / spread
    k = int(np.argmax(robot))  # the wall that would move the robot most
    shift = SIGMAS * float(spread[k])
    columns = np.concatenate((np.arange(3), np.arange(len(P))[V.columns(1 + int(walls[k]))]))
    H = rows[k][None, columns]
    told = Constraint(np.array([shift]), H[:, :3], gain_of(P, columns, H, np.array([[TOLD]])))
    pushed, _ = constrain(V, told, lambda _: np.array([shift]))
    after = copy.deepcopy(before)
    after.areas[after.current] = before.area._replace(V=pushed)
    return Moved(before, after, int(walls[k]), shift)


@cache
def driven_on():
    """Both drives to their end: (before, after) as results."""
    both = []
    for mapper in moved()[:2]:
        going = copy.deepcopy(mapper)
        for block in blocks()[1][1:]:
            going.take(block)
        both.append((going, assembled(going)))
    return both


def test_the_wall_goes_where_it_is_said_to_be():
    before, after, wall, shift = moved()
    offset = se2.between(before.area.V.poses[1 + wall], after.area.V.poses[1 + wall])
    assert offset[1] == pytest.approx(shift, rel=0.02)
    row = across(before.area.V, wall)
    assert row @ before.area.V.covariance @ row == pytest.approx((shift / SIGMAS) ** 2)
    assert row @ after.area.V.covariance @ row < 2e-8


def test_robot_and_other_landmarks_go_with_it_by_their_correlation():
    """To first order by the regression on the wall; every bound object of the area moves."""
    before, after, wall, shift = moved()
    V, W, f = before.area.V, after.area.V, before.area.features
    row = across(V, wall)
    P = V.covariance
    regression = P @ row / (row @ P @ row + TOLD) * shift
    for i in range(len(V.poses)):
        step = error_of("invariant", W.poses[i], V.poses[i])
        assert step == pytest.approx(regression[V.columns(i)], abs=2e-6)
    assert np.hypot(*(W.robot - V.robot)[:2]) > 5e-3
    assert abs(W.robot[2] - V.robot[2]) > 1e-5
    others = [i for i in np.flatnonzero((f.kind == WALL) | (f.kind == END)) if i != wall]
    steps = np.hypot(*(W.poses[1:] - V.poses[1:])[others, :2].T)
    assert (steps > 1e-5).all()
    assert np.median(steps) > 3e-4
    assert np.abs(W.parameters - V.parameters).max() > 1e-6


def test_what_was_learnt_makes_the_robot_surer():
    before, after, _, _ = moved()
    learnt = before.area.V.covariance - after.area.V.covariance
    assert np.linalg.eigvalsh(learnt).min() > -1e-12
    # Of the robot, in the direction in which the wall moves it.
    toward = (after.area.V.robot - before.area.V.robot)[:2]
    toward /= np.hypot(*toward)
    C, D = (area.area.V.covariance[:2, :2] for area in (before, after))
    assert toward @ D @ toward < 0.8 * toward @ C @ toward
    C, D = before.area.V.pose_covariance(0), after.area.V.pose_covariance(0)
    assert np.trace(D[:2, :2]) < np.trace(C[:2, :2])


def test_the_later_trajectory_moves_and_the_earlier_does_not():
    (_, plain), (_, pushed) = driven_on()
    assert isinstance(plain, MapResult)
    a, b = plain.trajectory.poses, pushed.trajectory.poses
    steps = np.hypot(*(b - a)[:, :2].T)
    last_key = [k for k in moved().before.trail.key_at if k < HERE][-1]
    assert steps[: last_key + 1].max() < 1e-3  # but for the loop at the end of the drive
    assert steps[HERE + 5 :].min() > 5e-4
    assert np.median(steps[HERE + 5 :]) > 2e-3


def test_the_next_area_and_its_landmarks_move_in_g():
    """The corridor, entered later: its frame hangs on the robot, who hangs on the wall."""
    (mapper, plain), (_, pushed) = driven_on()
    assert len(mapper.areas) == 2
    frames = [dict(result.model.environment.areas)["A2"].mean for result in (plain, pushed)]
    step = np.hypot(*(frames[1] - frames[0])[:2])
    assert step > 2e-3
    placed = []
    for result, frame in zip((plain, pushed), frames, strict=True):
        (area,) = (one for one in result.model.areas if one.id == "A2")
        kinds = {one.id: one.kind for one in result.model.landmarks}
        placed.append([(kinds[i], se2.compose(frame, e.mean)) for i, e in area.landmarks])
    steps = []
    for kind, pose in placed[0]:
        apart = [np.hypot(*(other - pose)[:2]) for k, other in placed[1] if k == kind]
        if kind.startswith("corner") and min(apart, default=1.0) < 0.3:
            steps.append(min(apart))
    assert len(steps) >= 5
    assert min(steps) > 2e-4
    assert np.median(steps) > 2e-3


def test_the_document_holds_the_landmarks_where_the_filter_has_them():
    """What the area level says of its landmarks is what moved, not a copy of its own."""
    before, after, _, _ = moved()
    results = []
    for mapper in (before, after):
        finished = copy.deepcopy(mapper)
        results.append(assembled(finished).model)
    (one,), (other,) = (model.areas for model in results)
    assert len(one.landmarks) == len(other.landmarks) > 3
    steps = [
        np.abs(a.mean - b.mean).max()
        for (_, a), (_, b) in zip(one.landmarks, other.landmarks, strict=True)
    ]
    assert min(steps) > 1e-6
    assert max(steps) > 1e-3
    assert np.abs(one.robot.mean - other.robot.mean).max() > 1e-3


def test_the_crossing_is_in_both_areas():
    """The robot's pose at the door is an object of the room and of the corridor."""
    (mapper, _), _ = driven_on()
    for area in mapper.areas:
        assert (area.features.kind == ANCHOR).sum() >= 1
