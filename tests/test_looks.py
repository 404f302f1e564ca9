"""The scans that make the free space: kept, and laid anew at other poses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.topology.looks import LookRecord
from hiermap_cli.mapping.topology.places import Places
from hiermap_cli.mapping.topology.seen_anew import seen_from
from hiermap_cli.mapping.topology.trace import Trace
from hiermap_cli.perception.sight import Sight

ORIGIN = np.array([0.1, -0.02])
STEP = 0.25  # metres between scans


def sight(pose, length=8.0, width=2.4, beams=120):
    """What is seen of a corridor about the X axis, from x = 0 to `length`."""
    eye = se2.compose(pose, np.array([*ORIGIN, 0.0]))
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False) + 1e-4
    d = np.column_stack((np.cos(angles), np.sin(angles)))
    low, high = np.array([0.0, -0.5 * width]), np.array([length, 0.5 * width])
    reach = (np.where(d > 0, high - eye[:2], low - eye[:2]) / d).min(axis=1)
    there = eye[:2] + reach[:, None] * d
    here = se2.compose(se2.invert(pose), np.column_stack((there, np.zeros(beams))))
    return Sight(ORIGIN, here[:, :2])


def driven(poses, seen, looks=None):
    """The places of one area gone through at `poses`, with what was truly seen."""
    places, trace = Places(1.7, looks), Trace()
    for key, (pose, one) in enumerate(zip(poses, seen, strict=True)):
        trace.add(pose, STEP if key else 0.0, one, key)
        places.look(0, trace, 1.0)
    places.look(0, trace, -1.0)
    return places


def straight(n=28):
    return np.array([[0.6 + STEP * k, 0.3 * np.sin(0.5 * k), 0.2 * np.cos(k)] for k in range(n)])


def bent(poses):
    """As of a robot that believes to turn a little with every metre."""
    out = [poses[0]]
    for a, b in itertools.pairwise(poses):
        out.append(se2.compose(out[-1], se2.compose(se2.between(a, b), np.array([0, 0, 0.02]))))
    return np.array(out)


def test_laid_anew_at_the_same_poses_it_is_the_same():
    poses, looks = straight(), LookRecord()
    places = driven(poses, [sight(p) for p in poses], looks)
    again = seen_from(looks.taken(), poses, np.zeros((1, 3)), 1.7)
    assert again.paths == places.paths
    one, other = places.grids[0], again.grids[0]
    assert other.scans == one.scans > 10
    # Ends are kept to a millimetre: a few samples lie on the other side of a cell's border.
    regions = [g.region(places.path(0), [], 0.8) for g in (one, other)]
    for a, b in (regions, regions[::-1]):
        assert np.mean(a.inside(b.centres())) > 0.98


def test_a_bent_area_is_straight_when_its_poses_are():
    poses, looks = straight(), LookRecord()
    wrong = driven(bent(poses), [sight(p) for p in poses], looks)
    right = seen_from(looks.taken(), poses, np.zeros((1, 3)), 1.7)

    def width(places):
        region = places.grids[0].region(places.path(0), [], 0.8)
        return np.ptp(region.centres()[:, 1])

    assert width(wrong) > 3.0
    assert width(right) == pytest.approx(2.4, abs=0.25)


def test_every_area_gets_its_own_in_its_frame():
    poses, looks = straight(), LookRecord()
    for key, pose in enumerate(poses):
        looks.add(key, int(key >= 14), sight(pose) if key % 2 == 0 else None)
    frames = np.array([[0.0, 0.0, 0.0], [4.0, 1.0, 0.5]])
    places = seen_from(looks.taken(), poses, frames, 1.7)
    assert [places.grids[i].scans for i in (0, 1)] == [7, 7]
    for i, there in ((0, poses[:14]), (1, poses[14:])):
        path = se2.compose(
            frames[i], np.column_stack((places.path(i), np.zeros(len(places.path(i)))))
        )
        d = np.hypot(*(there[:, None, :2] - path[:, :2]).transpose(2, 0, 1))
        assert d.min(axis=1).max() < 0.1  # every pose lies on the path
        assert d.min(axis=0).max() < 0.5 * STEP + 0.1  # and all of the path between poses


def test_scans_taken_back_leave_nothing():
    poses, looks, part = straight(), LookRecord(), LookRecord()
    for key, pose in enumerate(poses):
        looks.add(key, 0, sight(pose) if key % 2 else None)
        if key < 9:
            part.add(key, 0, sight(pose) if key % 2 else None)
    looks.rewind(9)
    for one, other in zip(looks.taken(), part.taken(), strict=True):
        assert np.array_equal(one, other)


def test_a_scan_takes_no_more_than_a_kilobyte():
    looks = LookRecord()
    for key in range(100):
        looks.add(key, 0, sight(np.array([4.0, 0.0, 0.0]), beams=233))  # all around
    kept = (looks._key, looks._area, looks._count, looks._origin, looks._ends)
    assert sum(len(a) * a.itemsize for a in kept) < 100 * 1000


def test_ends_are_kept_to_a_millimetre():
    looks, one = LookRecord(), sight(np.array([4.0, 0.0, 0.3]))
    looks.add(0, 0, one)
    taken = looks.taken()
    np.testing.assert_allclose(taken.ends, one.ends, atol=0.6e-3)
    np.testing.assert_allclose(taken.origin, ORIGIN[None], atol=1e-8)


def test_nothing_seen_is_nothing():
    places = seen_from(LookRecord().taken(), np.zeros((0, 3)), np.zeros((1, 3)), 1.7)
    assert places.grids == places.paths == {}
