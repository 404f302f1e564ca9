"""Known damage gives known figures, and all that is off is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from map_cases import (
    ROOMS,
    R_t_a,
    R_t_g,
    box,
    door_estimate,
    exact_model,
    exact_trajectory,
    reference_map,
    to_frame,
    true_path,
    with_doors,
    with_extent,
    without_area,
)

from hiermap_cli.documents.reference import ReferenceMap
from hiermap_cli.documents.tum import TimedPoses
from hiermap_cli.errors import InputError
from hiermap_cli.evaluation.judge import Given, Run, in_frame, judge, with_visits
from hiermap_cli.evaluation.limits import parse_limit
from hiermap_cli.evaluation.placed import move_points
from hiermap_cli.geometry.se2 import compose
from hiermap_cli.mapping.model import DoorModel, SegmentFeature

REFERENCE, TRUTH = reference_map(), true_path()
SHIFT = np.array([0.1, 0.2, np.radians(2.0)])


def judged(model=None, reference=REFERENCE, truth=TRUTH, trajectory=None, limits=()):
    run = Run(trajectory or exact_trajectory(), model or exact_model())
    return judge(run, Given(reference=reference, truth=truth), limits).document


def moved(reference: ReferenceMap, pose) -> ReferenceMap:
    assert reference.walls is not None
    return ReferenceMap(
        walls=move_points(pose, reference.walls.reshape(-1, 2)).reshape(-1, 4),
        furniture=reference.furniture,
        doors=tuple(
            replace(d, p1=move_points(pose, d.p1), p2=move_points(pose, d.p2))
            for d in reference.doors
        ),
        areas=tuple(replace(a, polygon=move_points(pose, a.polygon)) for a in reference.areas),
    )


def errors(document, kind, status):
    return [entry for entry in document.details["errors"][kind] if entry["status"] == status]


def test_a_reference_in_another_frame_changes_nothing():
    here = judged().values()
    there = judged(
        reference=moved(REFERENCE, SHIFT), truth=TimedPoses(TRUTH[0], compose(SHIFT, TRUTH[1]))
    ).values()
    assert set(here) == set(there)
    for name, value in here.items():
        assert there[name] == pytest.approx(value, abs=1e-6), name


def test_a_missing_room_is_named():
    document = judged(without_area(exact_model(), "A2"))
    missed = {(e["reference"], e["recalled"]) for e in errors(document, "areas", "missed")}
    assert missed == {("A2", 0.0)}
    assert errors(document, "doors", "missed") == [{"reference": "D1", "status": "missed"}]
    assert errors(document, "edges", "missed") == [{"reference": ["A1", "A2"], "status": "missed"}]
    assert not errors(document, "doors", "false")
    corners = np.array([e["true"] for e in errors(document, "landmarks", "missed")])
    x1, y1, x2, y2 = ROOMS["A2"]
    assert len(corners) == 6
    assert ((corners >= (x1, y1)) & (corners <= (x2, y2))).all()


def test_two_rooms_merged_are_one_area_over_both():
    merged = with_extent(without_area(exact_model(), "A2"), "A1", box(0.0, 0.0, 8.2, 3.0))
    document = judged(merged)
    (false,) = errors(document, "areas", "false")
    assert false["id"] == "A1"
    assert false["inside"] == pytest.approx(12.0 / 24.6)
    shares = {
        e["reference"]: (e["overlaps"], e["recalled"])
        for e in document.details["errors"]["areas"]
        if "recalled" in e
    }
    assert shares["A1"] == ("A1", pytest.approx(1.0))
    assert shares["A2"] == ("A1", pytest.approx(1.0))


def test_an_invented_door_is_named():
    model = exact_model()
    invented = DoorModel("D9", ("A2", "A3"), (), 0.9, door_estimate(np.array([6.0, 3.1])), 1)
    document = judged(with_doors(model, (*model.environment.doors, invented)))
    assert errors(document, "doors", "false") == [{"id": "D9", "status": "false"}]
    (edge,) = errors(document, "edges", "false")
    assert edge["areas"] == ["A2", "A3"]
    assert document.values()["door_precision"] == pytest.approx(2 / 3)


def test_walls_moved_by_5_cm_are_off_by_5_cm():
    """Every wall of a room, moved out of the room: its ends lie 5 cm from what is true."""
    model = exact_model()
    x1, y1, x2, y2 = ROOMS["A3"]
    outwards = {"x": (x1, x2), "y": (y1, y2)}
    landmarks = []
    poses = {l: e.mean for area in model.areas for l, e in area.landmarks}
    for landmark in model.landmarks:
        features = []
        for feature in landmark.features:
            R_t_l = compose(R_t_a[landmark.area], poses[landmark.id])
            ends = move_points(R_t_l, feature.endpoints)
            along_x = abs(ends[0, 1] - ends[1, 1]) < 1e-9
            axis, low, high = (1, *outwards["y"]) if along_x else (0, *outwards["x"])
            outer = abs(ends[0, axis] - low) < 1e-9 or abs(ends[0, axis] - high) < 1e-9
            if landmark.area == "A3" and outer:
                ends[:, axis] += 0.05 if abs(ends[0, axis] - high) < 1e-9 else -0.05
            features.append(
                SegmentFeature(0.0, 0.0, 1, np.zeros((2, 2)), to_frame(R_t_l, ends), (False, False))
            )
        landmarks.append(replace(landmark, features=tuple(features)))
    document = judged(replace(model, landmarks=tuple(landmarks)))
    distances = [
        e["wall_distance_max"]
        for e in document.details["errors"]["landmarks"]
        if e.get("area") == "A3" and "wall_distance_max" in e
    ]
    assert max(distances) == pytest.approx(0.05, abs=1e-9)
    assert 0.01 < document.values()["wall_rmse"] < 0.05
    assert document.values()["wall_outliers"] == 0.0


@pytest.mark.parametrize(("scale", "ratio"), [(4.0, 0.25), (0.25, 4.0)])
def test_nees_of_scaled_covariances(scale, ratio):
    rng = np.random.default_rng(3)
    exact = exact_trajectory()
    noise = rng.multivariate_normal(np.zeros(3), exact.covariances[0], len(exact.poses))
    noise[0] = 0.0
    noisy = replace(exact, poses=exact.poses + noise)
    honest, scaled = (
        judge(Run(replace(noisy, covariances=c * noisy.covariances)), Given(truth=TRUTH)).document
        for c in (1.0, scale)
    )
    assert honest.values()["nees_robot"] == pytest.approx(1.0, abs=0.2)
    assert scaled.values()["nees_robot"] == pytest.approx(ratio * honest.values()["nees_robot"])
    checks = {c["name"]: c for c in scaled.details["consistency"] if "where" not in c}
    state = checks["nees_robot"]["state"]
    assert state == ("cautious" if scale > 1 else "overconfident")
    assert honest.verdict.startswith("consistent")
    said = "overconfident by a factor of 2.0" if scale < 1 else "too cautious by a factor of 2.0"
    assert scaled.verdict.startswith(said)


def test_what_is_not_given_is_not_measured_and_says_so():
    document = judge(Run(exact_trajectory(), exact_model()), Given(truth=TRUTH)).document
    reasons = {one.name: one.reason for one in document.unmeasured}
    assert reasons["relations_trans_mean"] == "no relations were given"
    assert reasons["door_recall"] == "no reference map was given"
    assert not set(reasons) & set(document.values())
    bare = ReferenceMap(areas=REFERENCE.areas)
    reasons = {one.name: one.reason for one in judged(reference=bare).unmeasured}
    assert reasons["corner_recall"] == "the reference has no walls"
    assert reasons["door_recall"] == "the reference has no doors"


def test_a_limit_on_what_was_not_measured_is_missed():
    limits = [parse_limit("door_recall>=0"), parse_limit("relations_trans_mean<=99")]
    document = judged(limits=limits)
    assert [one.passed for one in document.limits] == [True, False]
    assert document.limits[1].value is None
    assert not document.passed


def test_no_time_in_common_says_whose_times_these_are():
    late = TimedPoses(TRUTH.stamps_ns + 10**15, TRUTH.poses)
    with pytest.raises(InputError, match=r"truth.tum: no two stamps .*\(1000000\.000 to") as caught:
        judge(Run(exact_trajectory()), Given(truth=late, names={"trajectory": "truth.tum"}))
    assert "0.000 to" in str(caught.value)


def test_a_trajectory_in_another_frame_does_not_align_the_map():
    far = compose(np.array([100.0, 0.0, 0.0]), TRUTH.poses)
    assert in_frame(TRUTH.poses, REFERENCE, None)
    assert not in_frame(far, REFERENCE, None)
    document = judged(truth=TimedPoses(TRUTH.stamps_ns, far))
    assert document.details["alignment"]["by"] == "maps"
    assert document.values()["ate_rmse"] == pytest.approx(0.0, abs=1e-9)


def test_visits_by_a_trajectory():
    seen = with_visits(REFERENCE, TRUTH.poses[:10])
    assert [area.visited for area in seen.areas] == [True, False, False]
    assert [door.visited for door in seen.doors] == [False, False]
    assert all(door.visited for door in with_visits(REFERENCE, TRUTH.poses).doors)


def test_only_a_trajectory_can_be_judged():
    document = judge(Run(exact_trajectory()), Given(reference=REFERENCE, truth=TRUTH)).document
    reasons = {one.name: one.reason for one in document.unmeasured}
    assert reasons["door_recall"] == "the run has no model"
    assert document.values()["ate_rmse"] == pytest.approx(0.0, abs=1e-9)


def test_the_frame_of_the_maps_is_that_of_the_model():
    document = judged()
    assert document.details["alignment"] == {
        "by": "trajectory",
        "pose": pytest.approx(R_t_g.tolist(), abs=1e-9),
    }
