"""Odometry that has lost its sign: told from truth by the walls, and bridged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiermap_cli.config import Config
from hiermap_cli.estimation.stochastic_map import predict
from hiermap_cli.evaluation.trajectory import ate
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.association.area_filter import observe
from hiermap_cli.mapping.filtering import run_filter
from hiermap_cli.mapping.levels import compose_levels
from hiermap_cli.mapping.odometry.direction import (
    DirectionWatch,
    Told,
    favours,
    reversed_,
    turned_from,
)
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import build_world, load_world

OFFICE = Path(__file__).resolve().parents[1] / "datasets" / "office.yaml"
ROOM = Path(__file__).resolve().parents[1] / "datasets" / "room.yaml"
REVERSED = {"faults": [{"kind": "reversed", "begin": 48.0, "end": 57.0}]}
FAULTY = ("odometry_reversed", "odometry_missing")


def filtered(blocks):
    mapper, _ = run_filter(iter(blocks), Config())
    mapper.finish()
    return mapper


def simulated(seed, **odometry):
    """A run in the room of figure 8, with settings of its wheels."""
    spec = load_world(ROOM).spec
    plain = spec.model_dump(exclude_none=True)
    plain["odometry"] |= odometry
    return simulate(build_world(type(spec).model_validate(plain)), np.random.default_rng(seed))


def off(mapper, simulation):
    """Root mean square error against the truth, metres."""
    trajectory = compose_levels(mapper).trajectory
    return ate(trajectory.stamps_ns, trajectory.poses, simulation.stamps_ns, simulation.truth).rmse


def stretches(mapper, kind):
    start = mapper.trail.stamps_ns[0] / 1e9
    return [
        (event.details["begin"] - start, event.details["end"] - start)
        for event in mapper.events
        if event.kind == kind
    ]


def test_a_direction_turned_about_midway():
    steps = np.array([[0.1, 0.0, 0.1], [0.1, 0.01, 0.0], [0.2, 0.0, -0.2]])
    increments = [np.zeros(3)]
    for step in steps:
        increments.append(se2.compose(increments[-1], step))
    increments = np.array(increments[1:])
    turned = turned_from(increments, 0)
    back = [turned[0], *(se2.between(turned[i], turned[i + 1]) for i in range(2))]
    np.testing.assert_allclose(back[0], steps[0], atol=1e-12)
    np.testing.assert_allclose(np.array(back[1:]), reversed_(steps[1:]), atol=1e-12)
    np.testing.assert_allclose(turned_from(increments, -1), reversed_(increments), atol=1e-12)
    np.testing.assert_allclose(turned_from(increments, 2), increments, atol=1e-12)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_reversed_odometry_is_recognised_with_its_time_and_bends_nothing(seed):
    simulation = simulated(seed, **REVERSED)
    mapper = filtered(simulation.blocks())
    found = stretches(mapper, "odometry_reversed")
    assert len(found) == 1
    begin, end = found[0]
    assert begin == pytest.approx(48.0, abs=2.5)  # the robot stands still for a second or two
    assert end == pytest.approx(57.0, abs=2.5)
    assert off(mapper, simulation) < 0.05
    assert len(mapper.trail.stamps_ns) == len(simulation.stamps_ns)


def test_odometry_without_any_motion_is_bridged_and_told():
    simulation = simulated(2, faults=[{"kind": "missing", "begin": 54.5, "end": 57.5}])
    mapper = filtered(simulation.blocks())
    found = stretches(mapper, "odometry_missing")
    assert found
    assert 54.0 < found[0][0] < 56.5
    assert found[-1][1] < 59.0
    assert off(mapper, simulation) < 0.1
    keyscans = mapper.keyscans.taken()
    failed = (keyscans.stamps_ns[~keyscans.trusted] - keyscans.stamps_ns[0]) * 1e-9
    assert len(failed)
    assert ((failed > 54.5) & (failed < 59.0)).all()


@pytest.mark.parametrize("seed", [0, pytest.param(3, marks=pytest.mark.slow)])
def test_sound_odometry_is_never_doubted(seed):
    mapper = filtered(simulated(seed).blocks())
    assert not [event for event in mapper.events if event.kind in FAULTY or event.kind == "lost"]
    assert mapper.keyscans.taken().trusted.all()


def test_walls_favour_the_way_that_the_robot_has_come(monkeypatch):
    weighed = []

    def weigh(self, drive, key, view, step):
        weighed.append((self.stepper, drive, key, view, step))

    monkeypatch.setattr(DirectionWatch, "weigh", weigh)
    filtered(simulated(0).blocks())
    straight = [one for one in weighed if one[1].increments[-1, 0] > 0.15]
    assert len(straight) > 20
    pulled = 0
    for stepper, drive, key, view, step in straight:
        assert favours(Told(drive, key, view, step, 0.0)) > 25.0
        # Told the other way round, and little of that believed: the walls pull the robot back.
        back = reversed_(drive.increments)
        motion = stepper.motion(drive.before, back[-1], trusted=False)
        area = drive.before.with_map(predict(drive.before.V, motion))
        other = observe(area, view, key, stepper.config)
        wrong = drive._replace(increments=back, motion=motion)
        if np.hypot(*(other.area.V.robot - step.area.V.robot)[:2]) < 0.02:
            assert favours(Told(wrong, key, view, other, 0.0)) < 0.0
            pulled += 1
    assert pulled > 20


def test_odometry_that_has_backed_up_is_believed_ahead(monkeypatch):
    """What was open closes when such odometry tells of going ahead; before, it stays open."""
    watch, left = DirectionWatch.weigh, []

    def weigh(self, drive, key, view, step):
        self._told_backward = told
        other = watch(self, drive, key, view, step)
        ahead = drive.increments[-1, 0] > 0.0
        left.append((bool(ahead), bool(self._window)))
        return other

    monkeypatch.setattr(DirectionWatch, "weigh", weigh)
    for told in (1.0, 0.0):
        left.clear()
        filtered(simulated(0).blocks())
        assert any(ahead for ahead, _ in left)
        assert any(open_ for ahead, open_ in left if ahead) == (told == 0.0)


@pytest.mark.parametrize("seed", [62])
def test_ends_that_are_measured_ill_turn_nothing_about(seed):
    """What ceases to match costs less than outliers, but does not show the other direction.

    Turned about in a corridor, the robot drives on between walls that match either way; jambs
    that are two or three sigmas off cost what is told more than not knowing them costs the other.
    """
    simulation = simulate(load_world(OFFICE), np.random.default_rng(seed))
    mapper = filtered(simulation.blocks())
    assert not [event for event in mapper.events if event.kind in FAULTY or event.kind == "lost"]
    assert off(mapper, simulation) < 0.05


def test_what_is_recorded_is_what_was_believed():
    """The refinement gets increments whose direction is the true one, from the turn on."""
    simulation = simulated(0, **REVERSED)
    keyscans = filtered(simulation.blocks()).keyscans.taken()
    at = np.searchsorted(simulation.stamps_ns, keyscans.stamps_ns)
    true = se2.between(simulation.truth[at[:-1]], simulation.truth[at[1:]])
    told = keyscans.increments[1:]
    moving = np.abs(true[:, 0]) > 0.1
    assert moving.sum() > 50
    wrong = moving & (np.sign(told[:, 0]) != np.sign(true[:, 0]))
    assert wrong.sum() <= 1  # the one in which the direction changes
