"""A robot that is lifted while its odometry stands still: noticed by what it sees at once."""

from __future__ import annotations

import numpy as np
import pytest

from hiermap_cli.config import LostConfig
from hiermap_cli.mapping.odometry.carried import CALM, Carried, CarryWatch

BEAMS = 90


def told_of(odometry, ranges):
    watch = CarryWatch(LostConfig())
    return [
        watch.put_down(np.array([x, 0.0, 0.0]), r) for x, r in zip(odometry, ranges, strict=True)
    ]


def watched(odometry, ranges):
    return [told is Carried.SURELY for told in told_of(odometry, ranges)]


def scan(seed, noise):
    return np.random.default_rng(seed).uniform(1.0, 6.0, BEAMS) + noise.normal(0.0, 0.01, BEAMS)


@pytest.mark.parametrize("gap", [0, 7])  # scans of the air
def test_other_ranges_where_odometry_stands_are_another_place(gap):
    noise = np.random.default_rng(0)
    air = [scan(10 + k, noise) for k in range(gap)]
    ranges = [scan(1, noise) for _ in range(3)] + air + [scan(2, noise) for _ in range(3)]
    told = watched(np.zeros(len(ranges)), ranges)
    assert np.flatnonzero(told).tolist() == [3 + gap + 1]  # by the second scan there, and once


def test_who_is_put_down_where_all_is_nearer_was_carried():
    """From a room into a narrow corridor: not one range is longer."""
    noise = np.random.default_rng(0)
    here = [scan(1, noise) for _ in range(3)]
    there = [0.4 * scan(1, noise) for _ in range(3)]
    assert np.flatnonzero(watched(np.zeros(6), here + there)).tolist() == [4]


def test_few_other_ranges_leave_a_doubt_and_fewer_none():
    """Farther along a corridor only doors and the corridor's end are elsewhere."""
    noise = np.random.default_rng(0)
    for others, expected in ((14, Carried.MAYBE), (5, Carried.NO)):
        before = [scan(1, noise) for _ in range(3)]
        after = [scan(1, noise) for _ in range(3)]
        for r in after:
            r[:others] += np.where(np.arange(others) % 2, 1.0, -0.5)
        told = told_of(np.zeros(6), before + after)
        assert told[4] is expected
        assert told[:4] + told[5:] == [Carried.NO] * 5


def test_odometry_that_moves_explains_other_ranges():
    noise = np.random.default_rng(0)
    ranges = [scan(1, noise) for _ in range(3)] + [scan(2, noise) for _ in range(3)]
    assert not any(watched([0.0, 0.0, 0.0, 0.1, 0.1, 0.1], ranges))


def test_who_steps_before_the_robot_and_a_door_that_opens_do_not_carry_it():
    noise = np.random.default_rng(0)
    before = [scan(1, noise) for _ in range(3)]
    for change in (-0.6, 2.0):
        after = [r.copy() for r in before]
        for r in after:
            r[10:40] += change
        assert not any(watched(np.zeros(6), before + after))


def test_people_who_go_on_walking_do_not_carry_it():
    noise = np.random.default_rng(0)
    ranges = []
    for k in range(12):
        r = scan(1, noise)
        who = np.arange(8 * k, 8 * k + 30) % BEAMS
        r[who] = np.where(np.arange(30) % 2, 0.8, 6.5)
        ranges.append(r)
    assert 16 / BEAMS > CALM
    assert not any(watched(np.zeros(12), ranges))


def test_a_robot_that_moved_unnoticed_is_not_carried_when_it_stands_again():
    noise = np.random.default_rng(0)
    watch = CarryWatch(LostConfig())
    still = np.zeros(3)
    for _ in range(3):
        assert watch.put_down(still, scan(1, noise)) is Carried.NO
    watch.forget()
    assert watch.put_down(still, scan(2, noise)) is Carried.NO
    assert watch.put_down(still, scan(2, noise)) is Carried.NO


def test_scans_that_say_little_or_differ_in_number_tell_nothing():
    noise = np.random.default_rng(0)
    blind = np.full(BEAMS, np.inf)
    assert not any(watched(np.zeros(4), [blind, blind, scan(1, noise), scan(1, noise)]))
    few = [scan(1, noise)] * 2 + [scan(2, noise)[:40]] * 2
    assert not any(watched(np.zeros(4), few))
