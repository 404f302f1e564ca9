"""Segments of noisy scans: what their covariances say is what their errors are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scan_cases import FULL, HALF, ROOM, block, cast, in_world, line_errors, scans

from hiermap_cli.config import LaserConfig, SegmentationConfig
from hiermap_cli.perception.segmentation import segment_block
from hiermap_cli.perception.segments import END_FREE, END_VERTEX

CONFIG = SegmentationConfig()
ORIGIN = (0.0, 0.0, 0.0)
SCANS = 5000


def wall(distance, incidence, half):
    """A wall whose middle is straight ahead, turned by `incidence` from facing the laser."""
    t = np.array((-np.sin(incidence), np.cos(incidence)))
    return (distance - half * t[0], -half * t[1], distance + half * t[0], half * t[1])


def noisy(ranges, laser, rng, sigma):
    """A block of many scans of the same ranges (beams,), each with its own noise."""
    many = np.repeat(ranges[None], SCANS, axis=0)
    return block(many + sigma * rng.standard_normal(many.shape), laser)


def nees(found, walls, poses=None):
    """Squared errors of (alpha, d_c) over their covariances, per degree of freedom, (S,)."""
    turn, off = line_errors(found, [ORIGIN] * SCANS if poses is None else poses, walls)
    e = np.stack((turn, off), axis=1)
    return np.einsum("si,sij,sj->s", e, np.linalg.inv(found.covariance), e) / 2


def whole(found, length):
    """Without the few pieces of walls that chance has broken, at most five in a thousand."""
    some = found.length > length
    assert (~some).mean() < 0.005
    return dataclasses.replace(
        found, **{f.name: getattr(found, f.name)[some] for f in dataclasses.fields(found)}
    )


@pytest.mark.parametrize(
    ("distance", "incidence", "half", "beams", "sigma"),
    [
        (1.0, 0.0, 1.0, 361, 0.01),
        (3.0, 0.0, 1.5, 361, 0.01),
        (3.0, 0.9, 2.0, 361, 0.01),
        (8.0, 0.5, 2.0, 361, 0.01),
        (1.0, 1.2, 2.0, 361, 0.01),
        (5.0, 0.3, 1.0, 181, 0.01),
        (2.0, -0.7, 1.0, 721, 0.005),
        (3.0, 0.2, 1.5, 361, 0.03),
        (8.0, 0.5, 2.0, 361, 0.03),
    ],
)
def test_lines_are_as_uncertain_as_they_say(distance, incidence, half, beams, sigma):
    laser = HALF._replace(beams=beams, angle_increment=np.pi / (beams - 1))
    walls = [wall(distance, incidence, half)]
    scan = noisy(cast(walls, ORIGIN, laser.angles()), laser, np.random.default_rng(2), sigma)
    found = segment_block(scan, LaserConfig(sigma_range=sigma), CONFIG)
    assert len(found.scan) >= SCANS
    assert nees(whole(found, half), walls).mean() == pytest.approx(1.0, abs=0.05)


def test_noise_may_grow_with_the_range():
    walls = [wall(4.0, 0.6, 2.0)]
    ranges = cast(walls, ORIGIN, HALF.angles())
    sigma = 0.005 + 0.003 * np.where(np.isfinite(ranges), ranges, 0.0)
    scan = noisy(ranges, HALF, np.random.default_rng(3), sigma)
    laser = LaserConfig(sigma_range=0.005, sigma_range_scale=0.003)
    assert nees(segment_block(scan, laser, CONFIG), walls).mean() == pytest.approx(1.0, abs=0.05)


def test_bearings_may_be_noisy():
    walls = [wall(3.0, 0.8, 2.0)]
    rng = np.random.default_rng(5)
    off = 0.002 * rng.standard_normal((SCANS, HALF.beams))
    ranges = cast(walls, ORIGIN, (HALF.angles() + off).ravel()).reshape(off.shape)
    ranges += 0.01 * rng.standard_normal(ranges.shape)
    laser = LaserConfig(sigma_range=0.01, sigma_bearing=0.002)
    found = segment_block(block(ranges), laser, CONFIG)
    assert nees(found, walls).mean() == pytest.approx(1.0, abs=0.05)


def test_a_wall_rougher_than_the_noise_is_as_uncertain_as_it_is_rough():
    walls = [wall(3.0, 0.4, 1.5)]
    ranges = cast(walls, ORIGIN, HALF.angles())
    cosine = np.cos(HALF.angles() - 0.4)
    sigma = np.hypot(0.004, np.where(np.isfinite(ranges), 0.010 / cosine, 0.0))
    scan = noisy(ranges, HALF, np.random.default_rng(6), sigma)
    found = segment_block(scan, LaserConfig(sigma_range=0.004), CONFIG)
    assert nees(whole(found, 1.5), walls).mean() == pytest.approx(1.0, abs=0.15)


def test_walls_of_a_room_are_as_uncertain_as_they_say():
    rng = np.random.default_rng(8)
    poses = [(rng.uniform(3.2, 5.6), rng.uniform(0.5, 3.5), rng.uniform(-3, 3)) for _ in range(600)]
    ranges = scans(ROOM, poses)
    found = segment_block(
        block(ranges + 0.01 * rng.standard_normal(ranges.shape)), LaserConfig(), CONFIG
    )
    consistency = nees(found, ROOM, poses)
    assert np.median(consistency) == pytest.approx(np.log(2.0), abs=0.05)
    assert consistency.mean() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("incidence", "share"), [(0.0, 0.995), (0.8, 0.98)])
def test_free_ends_are_as_uncertain_as_they_say(incidence, share):
    """Of a wall 0.15 m thick: past one end of the inclined one its face is seen, too."""
    rng = np.random.default_rng(9)
    t = np.array((-np.sin(incidence), np.cos(incidence)))
    depth = 0.15 * np.array((np.cos(incidence), np.sin(incidence)))
    ends = rng.uniform((-1.2, 0.9), (-0.9, 1.2), size=(1500, 2))
    middle = np.array((3.0, 0.0))
    walls = [(middle + a * t, middle + b * t) for a, b in ends]
    boxes = [[(*p, *q), (*p, *(p + depth)), (*q, *(q + depth))] for p, q in walls]
    ranges = np.array([cast(box, ORIGIN, HALF.angles()) for box in boxes])
    ranges += 0.01 * rng.standard_normal(ranges.shape)
    found = segment_block(block(ranges), LaserConfig(), CONFIG)
    found = whole(found, 1.7)
    for side, (p, kind) in enumerate(((found.p1, found.end1), (found.p2, found.end2))):
        free = kind == END_FREE
        assert free.mean() > share
        error = ((p - middle) @ t - ends[found.scan, side])[free]
        sigma = found.end_sigma[free, side]
        assert np.mean((error / sigma) ** 2) == pytest.approx(1.0, abs=0.1)
        # Neither end leans inwards or outwards.
        assert np.abs(error.mean()) < 0.1 * sigma.mean()


def test_vertices_are_as_uncertain_as_they_say():
    rng = np.random.default_rng(10)
    room = [(0, 0, 6, 0), (6, 0, 6, 4), (6, 4, 0, 4), (0, 4, 0, 0)]
    corners = np.array(room, dtype=float)[:, :2]
    poses = [(rng.uniform(1, 5), rng.uniform(1, 3), rng.uniform(-3, 3)) for _ in range(500)]
    ranges = scans(room, poses, FULL)
    found = segment_block(
        block(ranges + 0.01 * rng.standard_normal(ranges.shape), FULL), LaserConfig(), CONFIG
    )
    p1, p2, _, _ = in_world(found, poses)
    along = (p2 - p1) / found.length[:, None]
    for side, (p, kind) in enumerate(((p1, found.end1), (p2, found.end2))):
        vertex = kind == END_VERTEX
        # The others are those that the next wall is not known to reach: see the next test.
        assert vertex.mean() > 0.97
        off = p[vertex, None] - corners
        nearest = np.argmin(np.hypot(*off.transpose(2, 0, 1)), axis=1)
        error = (off[np.arange(len(off)), nearest] * along[vertex]).sum(axis=1)
        sigma = found.end_sigma[vertex, side]
        assert np.mean((error / sigma) ** 2) == pytest.approx(1.0, abs=0.2)
        # Points that both walls explain are of neither, which is not the same to both sides.
        assert np.abs(error.mean()) < 0.3 * sigma.mean()
