"""Ends of beams on people: told from what stands by what other scans have seen through."""

from __future__ import annotations

import numpy as np
import pytest

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.topology.again import STAYED, ended_about
from hiermap_cli.mapping.topology.near_ends import NearEnds
from hiermap_cli.mapping.topology.passers import (
    OVER,
    Passers,
    gone_over,
    looked,
    seen_through,
    went_over,
)

BEARINGS = np.radians(np.arange(-130.0, 130.5, 1.5))
PERSON = 0.25  # metres of radius


def scan(x, people):
    """Ends (n, 2) of beams from (x, 0) between walls at y = -2 and y = 2, with people about."""
    out = []
    for b in BEARINGS:
        u = np.array([np.cos(b), np.sin(b)])
        r = min(2.0 / max(abs(u[1]), 1e-9), 9.0)
        for who in people:
            d = np.array(who) - (x, 0.0)
            along, off = d @ u, abs(d[0] * u[1] - d[1] * u[0])
            if off < PERSON and along > 0.0:
                r = min(r, along - np.sqrt(PERSON**2 - off**2))
        out.append((x, 0.0) + r * u)
    return np.array(out)


def on_people(points):
    """Which points are no wall and no end of reach."""
    return (np.abs(points[:, 1]) < 1.9) & (np.hypot(points[:, 0], points[:, 1]) < 4.0)


def told(scans, passers, near):
    for x, people in scans:
        ends = scan(x, people)
        here = ends[np.hypot(ends[:, 0] - x, ends[:, 1]) < 3.0]
        points, _ = passers.persisting(np.array([x, 0.0]), ends, here, near)
        near.append(points)


@pytest.mark.parametrize("scans", [
    [(0.0, [(1.8, 0.6)]), (0.3, [])],  # gone when looked again
    [(0.0, []), (0.3, [(1.8, 0.6)])],  # not there before
])  # fmt: skip
def test_what_another_scan_has_seen_through_does_not_persist(scans):
    near = NearEnds()
    told(scans, Passers(), near)
    assert sum(on_people(scan(x, people)).sum() for x, people in scans) > 5
    assert not on_people(near.since(0)).any()
    walls = np.abs(np.abs(near.since(0)[:, 1]) - 2.0) < 1e-6
    assert walls.sum() > 100


def test_what_stands_persists_and_so_do_the_jambs_about_it():
    near = NearEnds()
    told([(0.0, [(1.8, 0.6)]), (0.3, [(1.8, 0.6)]), (0.6, [(1.8, 0.6)])], Passers(), near)
    for k in range(3):
        assert on_people(near.since(k)).sum() > 5 * (3 - k)


def test_areas_change_their_frames_and_what_is_told_does_not():
    straight, turned = NearEnds(), NearEnds()
    scans = [(0.0, [(1.8, 0.6)]), (0.3, [])]
    told(scans, Passers(), straight)
    R = np.array([3.0, -2.0, 0.6])
    passers = Passers()
    told(scans[:1], passers, turned)
    turned.move(R)
    passers.move(R)
    ends = scan(0.3, [])
    here = ends[np.hypot(ends[:, 0] - 0.3, ends[:, 1]) < 3.0]
    turn = se2.rotation(R[2]).T
    origin = R[:2] + np.array([0.3, 0.0]) @ turn
    points, _ = passers.persisting(origin, R[:2] + ends @ turn, R[:2] + here @ turn, turned)
    turned.append(points)
    kept = [near.since(0)[np.abs(near.since(0)).max(axis=1) < 100.0] for near in (straight, turned)]
    np.testing.assert_allclose(R[:2] + kept[0] @ turn, kept[1], atol=1e-9)


def test_it_is_told_how_much_came_and_went():
    def metres(*scans):
        near, passers, out = NearEnds(), Passers(), []
        for x, people in scans:
            ends = scan(x, people)
            here = ends[np.hypot(ends[:, 0] - x, ends[:, 1]) < 3.0]
            points, look = passers.persisting(np.array([x, 0.0]), ends, here, near)
            near.append(points)
            out.append(look.gone)
        return out

    here, there = [(1.8, 0.6)], [(1.8, -0.6)]
    assert metres((0.0, here), (0.3, here), (0.6, here)) == [0.0, 0.0, 0.0]
    _, left, _ = metres((0.0, here), (0.3, []), (0.6, []))
    assert left == pytest.approx(np.pi * PERSON, abs=0.4)  # the half of him that was seen
    _, moved, _ = metres((0.0, here), (0.3, there), (0.6, there))
    assert moved > 1.5 * left


def test_a_scan_says_nothing_where_it_has_no_beams():
    look = looked(np.zeros(2), scan(0.0, []), np.zeros((0, 2)))
    points = np.array([[1.0, 0.3], [-1.0, 0.05], [0.0, 1.9], [0.0, 0.5]])
    assert seen_through(look, points).tolist() == [True, False, False, True]
    few = looked(np.zeros(2), scan(0.0, [])[:5], np.zeros((0, 2)))
    assert not seen_through(few, points).any()


def test_blanked_points_stay_so_when_room_is_made():
    near = NearEnds()
    near.append(np.zeros((10, 2)))
    at = near.position()
    near.append(np.ones((4, 2)))
    del near[:1]
    near.append(np.full((4090, 2), 2.0))  # more than there is room for
    near.blank(at, np.array([True, False, True, False]))
    assert (near.since(0)[:4] == 1.0).all(axis=1).tolist() == [False, True, False, True]
    near.blank(0, np.ones(10, dtype=bool))  # shed by now
    assert (near.since(0)[4:] == 2.0).all()


def test_the_robot_goes_over_no_jamb():
    path = np.array([[0.0, 0.0], [0.2, 0.0], [0.4, 0.0]])
    points = np.array([[0.2, 0.1], [0.2, 0.4], [0.7, 0.0]])
    assert gone_over(points, path).tolist() == [True, False, False]
    assert [went_over(point, path) for point in points] == [True, False, False]


def test_one_point_is_gone_over_as_many_are():
    rng = np.random.default_rng(5)
    path = np.cumsum(rng.normal(scale=0.2, size=(30, 2)), axis=0)
    points = path[rng.integers(30, size=200)] + rng.normal(scale=OVER, size=(200, 2))
    told = gone_over(points, path)
    assert told.any()
    assert not told.all()
    assert [went_over(point, path) for point in points] == told.tolist()


def test_scans_that_ended_near_a_point_are_told_for_all_points_at_once():
    rng = np.random.default_rng(4)
    scans = [rng.uniform(0.0, 1.0, (n, 2)) for n in (0, 5, 0, 9, 1, 0)]
    points = rng.uniform(0.0, 1.0, (7, 2))
    told = ended_about(scans, points)
    assert told.any()
    assert not told.all()
    for ends, row in zip(scans, told, strict=True):
        apart = np.hypot(*(ends[:, None] - points).T).T
        assert row.tolist() == (apart < STAYED).any(axis=0).tolist()
    assert ended_about(scans, points[:0]).shape == (6, 0)
    assert ended_about([], points).shape == (0, 7)
