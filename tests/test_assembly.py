"""The final result: three levels that hold together, and that are the estimator itself."""

import copy

import numpy as np
import pytest
from estimation_cases import assembled
from samples import same
from world_cases import TWO_ROOMS, world_of

from hiermap_cli.config import Config
from hiermap_cli.documents.checks import covariance_fault, first_bad_covariance
from hiermap_cli.documents.model_file import model_json
from hiermap_cli.documents.semantics import model_faults
from hiermap_cli.documents.shapes import ModelDocument
from hiermap_cli.errors import InputError
from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.estimation.stochastic_map import corrected
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import AreaMap
from hiermap_cli.mapping.mapper import Mapper
from hiermap_cli.mapping.run import map_log
from hiermap_cli.simulation.simulator import simulate

CONFIG = Config()
WAY = [
    [1.0, 1.0],
    [3.0, 1.0],
    [4.5, 2.0],
    [8.0, 2.0],
    [8.0, 2.8],
    [7.2, 2.0],
    [4.0, 2.0],
    [2.0, 3.0],
]


@pytest.fixture(scope="module")
def simulation():
    world = world_of(TWO_ROOMS, way_points=WAY)
    return simulate(world, np.random.default_rng(5))


@pytest.fixture(scope="module")
def result(simulation):
    return map_log(simulation.blocks(32), CONFIG)


@pytest.fixture(scope="module")
def model(result):
    return result.model


def poses(model):
    """R_g_l (3,) of every landmark, by its id."""
    frames = dict(model.environment.areas)
    return {
        id_: se2.compose(frames[area.id].mean, estimate.mean)
        for area in model.areas
        for id_, estimate in area.landmarks
    }


def test_what_is_there(model):
    assert [area.id for area in model.areas] == ["A1", "A2"]
    (door,) = model.environment.doors
    assert door.areas == ("A1", "A2")
    assert door.crossings == 2
    assert model.areas[1].entered_by == door.id
    assert model.areas[0].entered_by is None
    kinds = {landmark.kind for landmark in model.landmarks}
    assert {"corner_concave", "door"} <= kinds
    concave = [landmark for landmark in model.landmarks if landmark.kind == "corner_concave"]
    assert len(concave) == 8  # four of each room, none twice


def test_the_model_is_a_sound_document(model):
    assert model_faults(ModelDocument.model_validate_json(model_json(model))) == []


def test_the_levels_are_one_state(result):
    """The robot of the environment is that of its area, seen from g, and the way ends there."""
    environment = result.model.environment
    area = next(a for a in result.model.areas if a.id == "A1")  # where the robot ends
    frame = dict(environment.areas)["A1"]
    np.testing.assert_allclose(
        se2.compose(frame.mean, area.robot.mean), environment.robot.mean, atol=1e-9
    )
    np.testing.assert_allclose(result.trajectory.poses[-1], environment.robot.mean, atol=1e-9)
    # Scans after the last that the filter used go by odometry, without its faults' share.
    sigmas = [
        np.sqrt(np.diagonal(C))
        for C in (result.trajectory.covariances[-1], environment.robot.covariance)
    ]
    np.testing.assert_allclose(*sigmas, rtol=0.05)
    assert first_bad_covariance(result.trajectory.covariances) is None
    for landmark in result.model.landmarks:
        R_a_l = dict(next(a for a in result.model.areas if a.id == landmark.area).landmarks)
        robot = next(a for a in result.model.areas if a.id == landmark.area).robot
        np.testing.assert_allclose(
            se2.compose(R_a_l[landmark.id].mean, landmark.robot.mean), robot.mean, atol=1e-9
        )


def test_an_areas_frame_lies_on_the_door_that_it_was_entered_by(model):
    (door,) = model.environment.doors
    frame = dict(model.environment.areas)["A2"].mean
    d = se2.between(frame, door.estimate.mean)
    assert np.hypot(d[0], d[1]) < 0.25  # the robot tells only that it is in the wall's depth
    assert abs(d[2]) < 0.1


def test_doors_lie_on_both_faces_of_the_wall(model, simulation):
    (door,) = model.environment.doors
    faces = [poses(model)[id_] for id_ in door.landmarks]
    R = se2.between(*faces)
    assert R[1] == pytest.approx(0.2, abs=0.03)  # the wall's thickness, as it is
    assert abs(se2.wrap(R[2] - np.pi)) < 0.02
    assert door.width == pytest.approx(1.0, abs=0.1)
    R_w_g = se2.compose(simulation.truth[0], se2.invert(np.zeros(3)))
    at = se2.compose(R_w_g, door.estimate.mean)
    np.testing.assert_allclose(at[:2], [6.0, 2.0], atol=0.06)
    assert covariance_fault(door.estimate.covariance) is None


def test_errors_of_the_corners_are_what_the_covariances_say(model, simulation):
    true = np.array([[x, y] for x in (0.1, 5.9, 6.1, 9.9) for y in (0.1, 3.9)])
    frames = dict(model.environment.areas)
    values = []
    for area in model.areas:
        F = frames[area.id]
        for id_, estimate in area.landmarks:
            if not next(m for m in model.landmarks if m.id == id_).kind.startswith("corner"):
                continue
            at = se2.compose(F.mean, estimate.mean)
            e = se2.compose(simulation.truth[0], at)[:2]
            e = e - true[np.argmin(np.hypot(*(true - e).T))]
            e = se2.rotation(-simulation.truth[0, 2]) @ e
            J1 = se2.compose_D_first(F.mean, estimate.mean)[:2]
            J2 = se2.compose_D_second(F.mean, estimate.mean)[:2]
            C = J1 @ F.covariance @ J1.T + J2 @ estimate.covariance @ J2.T
            values.append(e @ np.linalg.solve(C, e) / 2.0)
    assert len(values) == 8
    assert np.mean(values) < 3.0  # one run: the eight share the robot's error
    assert np.max(values) < 9.0


def test_the_trajectory_has_every_scan_and_ends_where_the_truth_does(result, simulation):
    np.testing.assert_array_equal(result.trajectory.stamps_ns, simulation.stamps_ns)
    true = se2.between(simulation.truth[0], simulation.truth)
    error = np.hypot(*(result.trajectory.poses - true)[:, :2].T)
    assert error.max() < 0.1


def test_the_same_log_gives_the_same_result(simulation, result):
    again = map_log(simulation.blocks(32), CONFIG)
    assert same(again.model, result.model)
    assert same(again.trajectory, result.trajectory)
    assert again.events == result.events


def test_a_log_without_scans_is_no_input():
    with pytest.raises(InputError, match="no scan"):
        map_log([], CONFIG)


# --- the levels are the estimator, not its decoration ---


def moved_wall(mapper: Mapper, wall: int, step: float) -> Mapper:
    """The mapper as if it knew for certain that a wall of the current area lies `step` metres
    farther towards its free side: the Kalman update by that one thing."""
    out = copy.deepcopy(mapper)
    area = out.areas[out.current]
    V = area.V
    normal = se2.rotation(V.poses[1 + wall][2])[:, 1]
    P, where = V.covariance, V.columns(1 + wall)
    x, y = V.poses[1 + wall][:2]
    h = np.zeros(len(P))
    h[where] = [*normal, normal @ [-y, x]]  # the wall's offset by its invariant error
    S = h @ P @ h
    delta = P @ h / S * step
    P = symmetrise(P - np.outer(P @ h, P @ h) / S)
    out.areas[out.current] = AreaMap(corrected(V, delta, P), area.features, area.next_uid)
    return out


def test_moving_one_landmark_moves_the_robot_the_others_and_the_later_trajectory(simulation):
    blocks = list(simulation.blocks(16))
    half = len(blocks) // 4  # still in the first area
    mapper = Mapper(CONFIG)
    for block in blocks[:half]:
        mapper.take(block)
    step = 0.02
    wall = int(np.argmax(mapper.area.features.seen))
    changed = moved_wall(mapper, wall, step)
    known = len(mapper.trail.stamps_ns)
    results = []
    for one in (mapper, changed):
        now = assembled(copy.deepcopy(one))
        for block in blocks[half:]:
            one.take(block)
        results.append((now, assembled(one)))
    (before, end_before), (after, end_after) = results

    # At once: the landmark on that wall, its neighbours, and the robot.
    moved = {
        id_: np.hypot(*(pose - poses(before.model)[id_])[:2])
        for id_, pose in poses(after.model).items()
        if id_ in poses(before.model)
    }
    assert max(moved.values()) > 0.5 * step
    assert len(moved) >= 4
    assert all(distance > 1e-5 for distance in moved.values())
    robots = [r.model.environment.robot.mean for r in (before, after)]
    assert np.hypot(*(robots[1] - robots[0])[:2]) > 1e-4
    # What had been written down before stays; all that comes later moves.
    same_part = slice(0, known - 20)
    np.testing.assert_array_equal(
        end_after.trajectory.poses[same_part], end_before.trajectory.poses[same_part]
    )
    later = end_after.trajectory.poses[known:] - end_before.trajectory.poses[known:]
    assert (np.abs(later).max(axis=1) > 1e-6).all()
    frames = [dict(r.model.environment.areas)["A2"].mean for r in (end_before, end_after)]
    assert np.abs(frames[1] - frames[0]).max() > 1e-6  # and the area behind the door with it
