from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from map_cases import (
    DOORS,
    SIGMA,
    R_t_a,
    R_t_g,
    exact_model,
    exact_trajectory,
    reference_map,
    true_path,
)

from hiermap_cli.documents.reference import ReferenceMap
from hiermap_cli.evaluation.consistency import (
    door_faces,
    first_pose_alignment,
    landmark_nees,
    nees_values,
    position_sigmas,
    robot_nees,
)
from hiermap_cli.evaluation.placed import is_corner, is_door, landmark_points, move_points
from hiermap_cli.geometry.se2 import between, compose, invert
from hiermap_cli.mapping.model import Trajectory

TRUTH = true_path()
REFERENCE = reference_map()


def test_values_of_a_diagonal_and_a_correlated_covariance() -> None:
    errors = np.array([[1.0, 2.0], [1.0, 1.0]])
    covariances = np.array([[[1.0, 0.0], [0.0, 4.0]], [[2.0, 1.0], [1.0, 2.0]]])
    # The second: C^-1 = [[2, -1], [-1, 2]] / 3, e' C^-1 e = 2/3.
    assert nees_values(errors, covariances) == pytest.approx([1.0, 1.0 / 3.0])


def test_singular_covariances_are_left_out() -> None:
    correlated = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    known = np.diag([1.0, 1.0, 0.0])
    small = np.diag([1e-12, 1e-12, 1e-16])
    values = nees_values(np.full((3, 3), 1e-6), np.array([correlated, known, small]))
    assert np.isnan(values[:2]).all()
    assert values[2] == pytest.approx((1 + 1 + 1e4) / 3)


def noisy_trajectory(seed: int, factor: float = 1.0) -> Trajectory:
    """Errors drawn from a covariance with correlations, which is stated `factor` times as large."""
    rng = np.random.default_rng(seed)
    exact = exact_trajectory()
    root = np.array([[0.05, 0.0, 0.0], [0.02, 0.04, 0.0], [0.01, -0.01, 0.03]])
    poses = exact.poses + rng.normal(size=exact.poses.shape) @ root.T
    poses[0] = exact.poses[0]
    covariances = np.tile(factor * root @ root.T, (len(poses), 1, 1))
    covariances[0] = 0.0
    return Trajectory(exact.stamps_ns, poses, covariances)


def test_an_honest_covariance_gives_one() -> None:
    values = [robot_nees(noisy_trajectory(seed), *TRUTH) for seed in range(40)]
    assert {result.n for result in values} == {len(TRUTH.poses) - 1}  # the first is singular
    # 40 runs of 139 poses and 3 degrees of freedom: the mean's own deviation is 0.011.
    assert np.mean([result.mean for result in values]) == pytest.approx(1.0, abs=0.05)


def test_nees_goes_with_the_inverse_of_the_covariance() -> None:
    honest = robot_nees(noisy_trajectory(3), *TRUTH)
    for factor in (0.25, 9.0):
        scaled = robot_nees(noisy_trajectory(3, factor), *TRUTH)
        assert scaled.mean == pytest.approx(honest.mean / factor)
        assert scaled.values[1:] == pytest.approx(honest.values[1:] / factor)


def test_put_together_at_the_first_common_pose_not_by_best_fit() -> None:
    exact = exact_trajectory()
    # The heading drifts as if the first pose had been 0.1 rad off: a best fit would hide it.
    turned = compose(np.array([0.0, 0.0, 0.1]), exact.poses)
    turned[0] = exact.poses[0]
    result = robot_nees(Trajectory(exact.stamps_ns, turned, exact.covariances), *TRUTH)
    apart = np.hypot(*(turned - exact.poses)[1:, :2].T)
    expected = (apart**2 + 0.1**2) / SIGMA**2 / 3
    assert result.values[1:] == pytest.approx(expected, rel=1e-6)
    assert result.values[0] == pytest.approx(0.0, abs=1e-12)


def test_first_common_pose_when_the_truth_begins_later() -> None:
    exact = exact_trajectory()
    later = TRUTH.stamps_ns[20:], TRUTH.poses[20:]
    aligned = first_pose_alignment(exact.stamps_ns, exact.poses, *later)
    # Not the poses up to 0.5 s before it: the robot was elsewhere then.
    assert aligned == pytest.approx(compose(TRUTH.poses[20], invert(exact.poses[20])))
    assert robot_nees(exact, *later).n == len(TRUTH.poses) - 20
    assert robot_nees(exact, *later).mean == pytest.approx(0.0, abs=1e-12)
    assert first_pose_alignment(exact.stamps_ns, exact.poses, later[0] + 10**12, later[1]) is None


def test_without_a_common_pose_there_is_no_figure() -> None:
    result = robot_nees(exact_trajectory(), TRUTH.stamps_ns + 10**12, TRUTH.poses)
    assert result.n == 0
    assert result.metrics("nees_robot") == ()


def test_landmarks_that_are_off_by_a_known_amount() -> None:
    model = exact_model()
    off = np.array([0.03, -0.01])
    nees = landmark_nees(model, REFERENCE, compose(np.array([*off, 0.0]), R_t_g), R_t_g)
    assert nees.n == 20 + 4  # corners, and doors from each side
    chosen = [*filter(is_corner, model.landmarks), *filter(is_door, model.landmarks)]
    points = landmark_points(model, chosen)
    in_g = off @ np.linalg.inv([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]]).T
    expected = [in_g @ np.linalg.solve(C, in_g) / 2 for C in points.covariances]
    assert nees.mean == pytest.approx(np.mean(expected))
    assert nees.metrics("nees_landmarks")[0].n == 24


def test_covariance_goes_through_area_frame_and_landmark() -> None:
    model = exact_model()
    landmark = model.landmarks[0]
    points = landmark_points(model, [landmark])
    frame = dict(model.environment.areas)[landmark.area].mean
    arm = points.points[0] - frame[:2]
    lever = np.array([-arm[1], arm[0]])
    expected = SIGMA**2 * (2.0 * np.eye(2) + np.outer(lever, lever))
    assert points.covariances[0] == pytest.approx(expected)


def test_nees_of_landmarks_goes_with_the_inverse_of_the_covariance() -> None:
    model = exact_model()
    wider = replace(
        model,
        environment=replace(
            model.environment,
            areas=tuple(
                (name, replace(e, covariance=4.0 * e.covariance))
                for name, e in model.environment.areas
            ),
        ),
        areas=tuple(
            replace(
                area,
                landmarks=tuple(
                    (name, replace(e, covariance=4.0 * e.covariance)) for name, e in area.landmarks
                ),
            )
            for area in model.areas
        ),
    )
    shifted = compose(np.array([0.02, 0.02, 0.0]), R_t_g)
    honest = landmark_nees(model, REFERENCE, shifted, R_t_g)
    assert landmark_nees(wider, REFERENCE, shifted, R_t_g).mean == pytest.approx(honest.mean / 4)


def test_a_door_has_a_place_on_each_face_of_its_wall() -> None:
    assert REFERENCE.doors is not None
    first, second = REFERENCE.doors
    # Point and way out, from A1 to the right and upwards, back from A2 and A3.
    faces = sorted((*f.point, *f.out) for f in door_faces(first, REFERENCE))
    assert np.array(faces) == pytest.approx(
        np.array([(4.0, 1.45, 1.0, 0.0), (4.2, 1.45, -1.0, 0.0)])
    )
    faces = sorted((*f.point, *f.out) for f in door_faces(second, REFERENCE))
    assert np.array(faces) == pytest.approx(np.array([(1.5, 3.0, 0.0, 1.0), (1.5, 3.2, 0.0, -1.0)]))
    # Without walls the door's own line is all that is known, and it has no sides.
    (face,) = door_faces(first, ReferenceMap())
    assert face.point == pytest.approx(np.mean(DOORS["D1"][1:], axis=0))
    assert not face.out.any()


def door_nees(moved_to: dict[str, float]) -> dict[str, float]:
    """NEES of D1's landmarks by area, where they lie at these x in the reference's frame."""
    model = exact_model()
    chosen = {}
    areas = []
    for area in model.areas:
        landmarks = list(area.landmarks)
        if area.id in moved_to:
            doors = {l.id for l in filter(is_door, model.landmarks)}
            i = next(k for k, (name, _) in enumerate(landmarks) if name in doors)
            name, estimate = landmarks[i]
            chosen[name] = area.id
            theta = -0.5 * np.pi if area.id == "A1" else 0.5 * np.pi
            pose = between(R_t_a[area.id], np.array([moved_to[area.id], 1.45, theta]))
            landmarks[i] = (name, replace(estimate, mean=pose))
        areas.append(replace(area, landmarks=tuple(landmarks)))
    nees = landmark_nees(replace(model, areas=tuple(areas)), REFERENCE, R_t_g, R_t_g)
    values = dict(zip(nees.ids, nees.values, strict=True))
    return {area: float(values[name]) for name, area in chosen.items()}


def test_a_door_is_held_to_the_face_on_its_own_side() -> None:
    # A2's door was taken for one on A1's face, nearer to it than A1's own, which is nearly right.
    nees = door_nees({"A1": 4.005, "A2": 3.999})
    right = door_nees({"A1": 4.005, "A2": 4.2})
    wrong = door_nees({"A1": 4.0, "A2": 3.999})
    assert nees["A1"] == pytest.approx(right["A1"])
    assert nees["A2"] == pytest.approx(wrong["A2"])
    assert 0.0 < nees["A1"] < 0.05
    assert nees["A2"] > 10.0
    # Where they truly are, each in its area's own frame, nothing is off.
    assert door_nees({"A1": 4.0, "A2": 4.2}) == pytest.approx({"A1": 0.0, "A2": 0.0}, abs=1e-9)


def test_moved_points_keep_their_nees() -> None:
    model = exact_model()
    points = landmark_points(model, filter(is_corner, model.landmarks))
    moved = points.moved(R_t_g)
    assert moved.points == pytest.approx(move_points(R_t_g, points.points))
    errors = np.full((len(points.ids), 2), 0.01)
    turn = np.array([[math.cos(0.7), -math.sin(0.7)], [math.sin(0.7), math.cos(0.7)]])
    assert nees_values(errors @ turn.T, moved.covariances) == pytest.approx(
        nees_values(errors, points.covariances)
    )


def test_position_sigma_is_over_both_axes() -> None:
    assert position_sigmas(np.diag([0.09, 0.16, 9.0])[None]) == pytest.approx([0.5])
