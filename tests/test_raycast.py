"""Ray casting against closed forms and against the plain ray-by-ray computation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from world_cases import TWO_ROOMS, world_of

from hiermap_cli.geometry.se2 import compose
from hiermap_cli.logs.records import LaserGeometry, Mount
from hiermap_cli.simulation.floors import office_floor
from hiermap_cli.simulation.raycast import CHUNK, RayCaster

DEGREE = np.pi / 180.0
FULL = LaserGeometry(-np.pi, DEGREE, 360, 0.0, 20.0)
# A room from (0, 0) to (6, 4), seen from inside: faces run counterclockwise.
ROOM = np.array(
    [[0.0, 0, 6, 0], [6.0, 0, 6, 4], [6.0, 4, 0, 4], [0.0, 4, 0, 0]],
)


def in_the_room(x, y, angles):
    """Range to the room's walls from inside, in closed form."""
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        along_x = np.where(c > 0, (6.0 - x) / c, -x / c)
        along_y = np.where(s > 0, (4.0 - y) / s, -y / s)
    return np.minimum(np.abs(along_x), np.abs(along_y))


def ray_by_ray(faces, origins, angles, range_max):
    """The textbook intersection of every ray with every face, front sides only."""
    out = np.full((len(origins), len(angles)), np.inf)
    for row, (x, y, theta) in enumerate(origins):
        d = np.column_stack((np.cos(theta + angles), np.sin(theta + angles)))
        a, s = faces[:, :2] - [x, y], faces[:, 2:] - faces[:, :2]
        front = a[:, 0] * s[:, 1] - a[:, 1] * s[:, 0] > 0
        a, s = a[front], s[front]
        slope = d[:, None, 0] * s[None, :, 1] - d[:, None, 1] * s[None, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (a[:, 0] * s[:, 1] - a[:, 1] * s[:, 0])[None] / slope
            u = (a[None, :, 0] * d[:, None, 1] - a[None, :, 1] * d[:, None, 0]) / slope
            t = np.where((t > 0) & (u >= -1e-12) & (u <= 1 + 1e-12), t, np.inf)
        out[row] = t.min(axis=1, initial=np.inf)
    out[out > range_max] = np.inf
    return out


@settings(max_examples=60)
@given(st.floats(0.01, 5.99), st.floats(0.01, 3.99), st.floats(-4.0, 4.0), st.floats(-np.pi, np.pi))
def test_a_box_has_its_closed_form(x, y, theta, angle_min):
    laser = FULL._replace(angle_min=angle_min)
    ranges = RayCaster(ROOM, laser, Mount()).ranges(np.array([[x, y, theta]]))[0]
    assert np.allclose(ranges, in_the_room(x, y, theta + laser.angles()), atol=1e-9)


def test_no_beam_slips_between_two_faces_that_meet():
    corners = ROOM[:, :2]
    rng = np.random.default_rng(1)
    for here in rng.uniform([0.5, 0.5], [5.5, 3.5], (200, 2)):
        for corner in corners:  # the first beam goes exactly into the corner
            aim = float(np.arctan2(*(corner - here)[::-1]))
            pose = np.array([[*here, aim + np.pi]])
            ranges = RayCaster(ROOM, FULL, Mount()).ranges(pose)[0]
            assert ranges[0] == pytest.approx(np.hypot(*(corner - here)), abs=1e-6)
            assert np.isfinite(ranges).all()


def test_beyond_the_reach_nothing_returns():
    laser = FULL._replace(range_max=2.5)
    ranges = RayCaster(ROOM, laser, Mount()).ranges(np.array([[3.0, 2.0, 0.3]]))[0]
    expected = in_the_room(3.0, 2.0, 0.3 + laser.angles())
    assert np.array_equal(np.isinf(ranges), expected > 2.5)
    assert np.allclose(ranges[np.isfinite(ranges)], expected[expected <= 2.5])


def test_a_face_is_not_seen_from_behind():
    ranges = RayCaster(ROOM, FULL, Mount()).ranges(np.array([[-2.0, 2.0, 0.0]]))[0]
    assert ranges[180] == pytest.approx(8.0)  # through the near wall's back, to the far one


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("increment", [DEGREE, -DEGREE])
def test_mount_and_direction_of_the_beams(flipped, increment):
    laser = LaserGeometry(-1.5, increment, 170, 0.0, 20.0)
    mount = Mount(0.3, -0.1, 0.7, flipped)
    pose = np.array([2.0, 1.5, 0.4])
    x, y, theta = compose(pose, mount.pose())
    angles = theta + laser.angles() * (-1.0 if flipped else 1.0)
    ranges = RayCaster(ROOM, laser, mount).ranges(pose[None])[0]
    assert np.allclose(ranges, in_the_room(x, y, angles), atol=1e-9)


def test_a_disc_has_its_closed_form():
    discs = np.array([[[5.0, 2.0], [1.0, 3.9]]])
    ranges = RayCaster(ROOM, FULL, Mount()).ranges(np.array([[2.0, 2.0, 0.0]]), discs, 0.3)[0]
    angles = FULL.angles()
    expected = in_the_room(2.0, 2.0, angles)
    for x, y in discs[0] - [2.0, 2.0]:
        b, c = x * np.cos(angles) + y * np.sin(angles), x * x + y * y - 0.09
        hit = (b > 0) & (b * b > c)
        expected[hit] = np.minimum(expected[hit], b[hit] - np.sqrt(b[hit] ** 2 - c))
    assert np.allclose(ranges, expected, atol=1e-6)
    assert ranges[180] == pytest.approx(2.7)


def test_a_disc_that_holds_the_laser_is_not_seen():
    discs = np.array([[[2.1, 2.0]]])
    ranges = RayCaster(ROOM, FULL, Mount()).ranges(np.array([[2.0, 2.0, 0.0]]), discs, 0.3)[0]
    assert np.allclose(ranges, in_the_room(2.0, 2.0, FULL.angles()))


def test_without_faces_there_is_nothing():
    ranges = RayCaster(np.zeros((0, 4)), FULL, Mount()).ranges(np.zeros((3, 3)))
    assert ranges.shape == (3, 360)
    assert np.isinf(ranges).all()


def test_an_office_floor_ray_by_ray():
    world = office_floor(2, np.random.default_rng(7), laser={"range_max": 9.0})
    poses = world.journey.poses(np.linspace(0.0, world.journey.end, 3 * CHUNK + 5))
    laser, mount = world.laser, world.mount
    cast = RayCaster(world.plan.faces(), laser, mount).ranges(poses)
    chosen = slice(0, None, 4)
    origins = compose(poses[chosen], mount.pose())
    plain = ray_by_ray(world.plan.faces(), origins, laser.angles(), laser.range_max)
    assert 0.0 < np.isinf(plain).mean() < 0.2
    with np.errstate(invalid="ignore"):
        off = np.nan_to_num(np.abs(cast[chosen] - plain), nan=0.0)
    # A beam that just passes an edge may end on either side of it.
    assert np.count_nonzero(off > 1e-6) <= 2


def test_poses_cast_together_and_alone_are_the_same():
    world = world_of(TWO_ROOMS)
    poses = world.journey.poses(np.linspace(0.0, world.journey.end, 2 * CHUNK + 1))
    caster = RayCaster(world.plan.faces(), world.laser, world.mount)
    alone = np.vstack([caster.ranges(pose[None]) for pose in poses])
    assert np.array_equal(caster.ranges(poses), alone)
