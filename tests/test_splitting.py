"""Runs split level by level, all of a block at once, against the plain recursion on each."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scan_cases import ROOM, block, scans

from hiermap_cli.config import LaserConfig, SegmentationConfig
from hiermap_cli.perception.beams import arrange
from hiermap_cli.perception.breakpoints import breakpoints
from hiermap_cli.perception.splitting import split

LASER, CONFIG = LaserConfig(), SegmentationConfig()


def noisy(count, seed=4):
    """Ranges (count, beams) in the room, uneven enough to be split at many places."""
    rng = np.random.default_rng(seed)
    poses = np.column_stack(
        (rng.uniform(0.5, 5.5, count), rng.uniform(1.8, 3.8, count), rng.uniform(-3.0, 3.0, count))
    )
    ranges = scans(ROOM, poses)
    return ranges + 0.04 * rng.standard_normal(ranges.shape)


def split_block(ranges):
    beams = arrange(block(ranges), LASER, CONFIG.max_range)
    breaks = breakpoints(beams, LASER, CONFIG)
    return beams, breaks, split(beams, breaks, LASER, CONFIG)


def plain(beams, first, last):
    """The last points of all runs but one that are left of the run from `first` to `last`."""
    if last - first + 1 < CONFIG.min_points:
        return []
    points = np.column_stack((beams.x, beams.y))[first : last + 1]
    along = points[-1] - points[0]
    chord = float(np.hypot(*along))
    normal = np.array((-along[1], along[0])) / chord
    distance = np.abs((points - points[0]) @ normal)
    k = min(int(np.argmax(distance)), last - first - 1)
    most = distance.max()
    sigma = LASER.sigma_range + LASER.sigma_range_scale * beams.r[first + k]
    across = sigma * abs(normal @ points[k]) / beams.r[first + k]
    large = max(chord, most) > 0.5 * CONFIG.min_length
    if not (most > CONFIG.split_floor and large and most > CONFIG.split_sigmas * across):
        return []
    return [*plain(beams, first, first + k), first + k, *plain(beams, first + k + 1, last)]


def test_runs_are_those_of_the_plain_recursion():
    beams, breaks, (first, last) = split_block(noisy(40))
    expected = []
    surfaces = np.append(np.flatnonzero(breaks), len(breaks))
    for start, stop in pairwise(surfaces):
        expected += [*plain(beams, start, stop - 1), stop - 1]
    np.testing.assert_array_equal(last, expected)
    np.testing.assert_array_equal(first, np.append(0, last[:-1] + 1))
    assert len(first) > 2 * breaks.sum()  # most of them come from splitting


def test_a_scan_is_split_alike_in_any_block():
    ranges = noisy(30)
    beams, _, (first, _) = split_block(ranges)
    cells = beams.cell[first]
    for k, scan in enumerate(ranges):
        alone, _, (starts, _) = split_block(scan[None])
        width = alone.ranges.shape[1]
        np.testing.assert_array_equal(alone.cell[starts], cells[cells // width == k] % width)
