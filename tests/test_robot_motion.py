"""The driven robot, its wheels and the people about it."""

from __future__ import annotations

import numpy as np
import pytest
from world_cases import DATASETS, ONE_ROOM, SMALL_WORLDS, world_of

from hiermap_cli.config import OdometryConfig
from hiermap_cli.estimation.motion import motion
from hiermap_cli.geometry.se2 import between, compose, log, wrap
from hiermap_cli.simulation.odometry import read_wheels
from hiermap_cli.simulation.people import STEP, walk
from hiermap_cli.simulation.polygons import point_distances, way_clearance
from hiermap_cli.simulation.world import load_world

QUIET = {
    "sigma_xy_per_sqrt_m": 0.0,
    "sigma_xy_per_sqrt_rad": 0.0,
    "sigma_theta_per_sqrt_m": 0.0,
    "sigma_theta_per_sqrt_rad": 0.0,
}


def every(world, step):
    return np.arange(0.0, world.journey.end, step)


# --- driving ---


@pytest.mark.parametrize("name", [*SMALL_WORLDS, "office"])
def test_speed_turn_rate_and_acceleration_stay_bounded(name):
    world = load_world(DATASETS / f"{name}.yaml")
    robot, dt = world.spec.robot, 0.05
    poses = world.journey.poses(every(world, dt))
    twists = log(between(poses[:-1], poses[1:])) / dt
    assert np.abs(twists[:, 0]).max() <= robot.speed * 1.001
    assert np.abs(twists[:, 2]).max() <= robot.turn_rate * 1.001
    assert np.abs(np.diff(twists[:, 0])).max() <= 1.001 * robot.acceleration * dt
    on_the_spot = (np.abs(twists[:-1, 0]) < 1e-9) & (np.abs(twists[1:, 0]) < 1e-9)
    turn_steps = np.abs(np.diff(twists[:, 2]))[on_the_spot]
    assert turn_steps.max(initial=0.0) <= 1.001 * robot.turn_acceleration * dt
    assert np.abs(twists[:, 1]).max() < 1e-3 + robot.speed * robot.turn_rate * dt  # no side-step


@pytest.mark.parametrize("name", [*SMALL_WORLDS, "office"])
def test_the_robot_is_always_indoors_and_touches_nothing(name):
    world = load_world(DATASETS / f"{name}.yaml")
    points = world.journey.poses(every(world, 0.2))[:, :2]
    assert world.plan.indoors(points).all()
    assert point_distances(points, world.plan.faces()).min() >= world.spec.robot.radius - 0.01


def test_way_points_are_reached_in_order_and_stops_last():
    world = load_world(DATASETS / "room.yaml")
    arrivals = world.journey.arrivals
    assert (np.diff(arrivals.ravel()) >= 0.0).all()
    assert np.allclose(arrivals[:, 1] - arrivals[:, 0], 1.0)
    for moments in arrivals.T:
        here = world.journey.poses(moments)[:, :2]
        assert np.allclose(here, [point.at for point in world.spec.way_points], atol=1e-9)


def test_a_way_point_without_a_stop_is_rounded_off():
    world = world_of(ONE_ROOM)
    arrival = world.journey.arrivals[1]
    assert arrival[0] == arrival[1]
    corner = world.journey.poses(arrival[:1])[0]
    radius = world.spec.robot.turn_radius
    assert np.hypot(*(corner[:2] - [5.0, 1.0])) == pytest.approx(radius * (np.sqrt(2.0) - 1.0))
    assert corner[2] == pytest.approx(np.pi / 4)
    assert np.allclose(world.journey.poses(np.array([world.journey.end]))[0], [5, 3, np.pi / 2])


def test_being_lifted_moves_the_robot_and_not_its_wheels():
    lift = {"at": 3.0, "to": [5.0, 3.0, -2.0], "pause": 1.0}
    world = world_of(ONE_ROOM, lifts=[lift], odometry=QUIET)
    before, after = world.journey.poses(np.array([3.4999, 3.5001]))
    assert np.allclose(after, lift["to"])
    assert np.allclose(before, world_of(ONE_ROOM).journey.poses(np.array([3.0]))[0], atol=1e-9)
    wheels = read_wheels(world.journey, np.array([0.0, 3.2, 3.8]), world.spec.odometry, None)
    assert np.allclose(wheels[1], wheels[2])
    assert np.allclose(world.journey.poses(np.array([world.journey.end]))[0, :2], [5.0, 3.0])
    assert len(world.journey.arrivals) == 3


# --- wheels ---


def driven(world, seconds, rng=None):
    return read_wheels(world.journey, seconds, world.spec.odometry, rng)


@pytest.mark.parametrize("name", SMALL_WORLDS)
def test_exact_wheels_are_the_true_motion(name):
    world = load_world(DATASETS / f"{name}.yaml")
    seconds = every(world, 0.25)
    truth = world.journey.poses(seconds)
    off = between(driven(world, seconds), between(truth[0], truth))
    assert np.abs(off).max() < 1e-11


def straight(length, **odometry):
    base = {
        "areas": [{"id": "A", "box": [0.0, 0.0, length + 4.0, 4.0]}],
        "way_points": [[2.0, 2.0], [length + 2.0, 2.0]],
    }
    return world_of(base, odometry={**QUIET, **odometry})


@pytest.mark.parametrize("readings", [30, 300])
def test_noise_grows_with_the_way_whatever_the_rate_of_the_readings(readings):
    world = straight(9.0, sigma_xy_per_sqrt_m=0.03, sigma_theta_per_sqrt_m=1e-4)
    seconds = np.linspace(0.0, world.journey.end, readings)
    rng = np.random.default_rng(11)
    ends = np.array([driven(world, seconds, rng)[-1] for _ in range(800)]) - [9.0, 0.0, 0.0]
    expected = 3.0 * np.array([0.03, 0.03, 1e-4])
    assert np.allclose(ends.std(axis=0), expected, rtol=0.1)  # four sigmas of a sample of 800
    assert (np.abs(ends.mean(axis=0)) < 4.0 * expected / np.sqrt(800)).all()


def test_noise_grows_with_the_angle():
    turning = {"way_points": [[3.0, 2.0], [3.0 + 1e-6, 2.0]], "robot": {"heading": -2.0}}
    sigmas = {"sigma_xy_per_sqrt_rad": 0.02, "sigma_theta_per_sqrt_rad": 0.04}
    world = world_of(ONE_ROOM, **turning, odometry={**QUIET, **sigmas})
    seconds = np.linspace(0.0, world.journey.end, 50)
    rng = np.random.default_rng(12)
    ends = np.array([driven(world, seconds, rng)[-1] for _ in range(800)])
    assert np.allclose(wrap(ends[:, 2]).mean(), 2.0, atol=0.01)
    assert np.allclose(ends.std(axis=0), np.sqrt(2.0) * np.array([0.02, 0.02, 0.04]), rtol=0.1)


def test_slips_come_at_their_rate():
    slip = {"per_metre": 0.5, "sigma_translation": 0.2, "sigma_rotation": 0.0}
    world = straight(8.0, slip=slip)
    seconds = np.linspace(0.0, world.journey.end, 100)
    rng = np.random.default_rng(13)
    ends = np.array([driven(world, seconds, rng)[-1, 0] for _ in range(800)])
    assert ends.std() == pytest.approx(0.2 * np.sqrt(4.0), rel=0.12)


def test_constant_faults_are_those_that_the_estimator_calibrates():
    faults = {"scale": -0.036, "rotation_scale": 0.031, "curvature": 0.057}
    world = world_of(ONE_ROOM, odometry={**QUIET, **faults})
    seconds = every(world, 0.02)
    wheels = driven(world, seconds)
    parameters = np.array([*faults.values(), 0.0])
    pose = world.journey.poses(seconds[:1])[0]
    for increment in between(wheels[:-1], wheels[1:]):
        pose = compose(pose, motion(increment, parameters, OdometryConfig()).pose)
    assert np.allclose(pose, world.journey.poses(seconds[-1:])[0], atol=2e-4)


@pytest.mark.parametrize("duration", [0.0, 1.5])
def test_a_bend_is_a_false_motion_after_which_all_is_read_right(duration):
    bend = np.array([0.4, 0.0, np.deg2rad(5.0)])
    fault = {"after": 1, "bend": bend.tolist(), "duration": duration}
    plain = straight(4.0)
    halves = [[2.0, 2.0], [4.0, 2.0], [6.0, 2.0]]
    bent = world_of(
        {"areas": [{"id": "A", "box": [0.0, 0.0, 8.0, 4.0]}], "way_points": halves},
        odometry={**QUIET, "bends": [fault]},
    )
    assert plain.journey.end == pytest.approx(bent.journey.end)
    seconds = every(plain, 0.1)
    right, wrong = driven(plain, seconds), driven(bent, seconds)
    middle = 0.5 * (bent.journey.arrivals[1, 1] + bent.journey.arrivals[2, 0])
    before = seconds < middle - 0.5 * duration
    after = seconds > middle + 0.5 * duration
    assert np.allclose(right[before], wrong[before], atol=1e-12)
    first = int(np.flatnonzero(after)[0])
    assert np.allclose(
        between(wrong[first], wrong[after]), between(right[first], right[after]), atol=1e-9
    )
    last = int(np.flatnonzero(before)[-1])
    read, true = between(wrong[last], wrong[first]), between(right[last], right[first])
    if duration == 0.0:
        assert np.allclose(read, compose(true, bend), atol=1e-9)
    else:
        assert read[2] == pytest.approx(bend[2])
        assert np.hypot(*read[:2]) == pytest.approx(true[0] + 0.4, abs=0.01)


# --- people ---


def test_people_keep_off_walls_and_robot_and_keep_their_pace():
    world = load_world(DATASETS / "ring.yaml")
    people = world.spec.people.model_copy(update={"number": 8})
    robot = world.journey.poses(every(world, STEP))[:, :2]
    radius = world.spec.robot.radius
    positions = walk(world.plan, people, robot, radius, np.random.default_rng(2)).positions
    assert positions.shape == (len(robot), 8, 2)
    faces = world.plan.faces()
    for k in range(8):
        path = positions[:, k]
        assert world.plan.indoors(path).all()
        steps = np.hstack((path[:-1], path[1:]))
        assert way_clearance(steps, faces).min() >= people.radius
        pace = np.hypot(*np.diff(path, axis=0).T) / STEP
        assert pace.max() <= 2.0 * people.speed + 1e-9  # a step and a step back at most
        assert pace.max() > 0.9 * people.speed
        assert np.ptp(path, axis=0).max() > 2.0
    apart = np.hypot(*np.moveaxis(positions - robot[:, None], -1, 0))
    assert (apart < radius + people.radius).mean() < 0.01


def test_people_are_seeded():
    world = load_world(DATASETS / "room.yaml")
    people = world.spec.people.model_copy(update={"number": 3})
    robot = world.journey.poses(every(world, STEP))[:200, :2]
    walks = [walk(world.plan, people, robot, 0.2, np.random.default_rng(s)) for s in (5, 5, 6)]
    assert np.array_equal(walks[0].positions, walks[1].positions)
    assert not np.array_equal(walks[0].positions, walks[2].positions)


def test_positions_between_the_steps_are_interpolated():
    world = load_world(DATASETS / "room.yaml")
    people = world.spec.people.model_copy(update={"number": 2})
    robot = world.journey.poses(every(world, STEP))[:50, :2]
    walks = walk(world.plan, people, robot, 0.2, np.random.default_rng(5))
    middle = walks.at(np.array([0.95, 1e6]))
    assert np.allclose(middle[0], 0.5 * (walks.positions[9] + walks.positions[10]))
    assert np.allclose(middle[1], walks.positions[-1])
