from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from map_cases import (
    R_t_g,
    box,
    door_estimate,
    exact_model,
    exact_trajectory,
    reference_map,
    true_path,
    with_doors,
    with_extent,
    without_area,
)

from hiermap_cli.documents.reference import ReferenceMap
from hiermap_cli.evaluation.against import map_metrics
from hiermap_cli.evaluation.areas import area_metrics, topology_metrics
from hiermap_cli.evaluation.corners import end_corners, furniture_corners
from hiermap_cli.evaluation.doors import door_metrics
from hiermap_cli.evaluation.placed import place
from hiermap_cli.evaluation.visibility import ALL_AROUND, View
from hiermap_cli.mapping.model import DoorModel, HierarchicalModel

REFERENCE = reference_map()
TRUTH = true_path()


def judge(
    model: HierarchicalModel, reference: ReferenceMap = REFERENCE, view: View = ALL_AROUND
) -> dict[str, float]:
    figures = map_metrics(model, exact_trajectory(), reference, TRUTH, view)
    return {metric.name: metric.value for metric in figures}


def areas_of(model: HierarchicalModel, reference: ReferenceMap = REFERENCE):
    result = area_metrics(place(model, R_t_g), reference, TRUTH.poses)
    assert result is not None
    return result


def test_a_perfect_model_is_perfect() -> None:
    figures = judge(exact_model())
    zero = {"corner_rmse", "wall_rmse", "wall_outliers", "door_rmse", "nees_landmarks"}
    ones = {
        *("corner_precision", "corner_recall", "door_precision", "door_recall"),
        *("area_precision", "area_recall", "area_f1_iou50"),
        *("topology_precision", "topology_recall"),
    }
    assert set(figures) == zero | ones
    assert {name: figures[name] for name in zero} == pytest.approx(
        dict.fromkeys(zero, 0.0), abs=1e-9
    )
    assert {name: figures[name] for name in ones} == pytest.approx(dict.fromkeys(ones, 1.0))


def test_a_missing_room() -> None:
    figures = judge(without_area(exact_model(), "A2"))
    # One of three areas is gone with its door: the only one of two edges.
    assert figures["area_recall"] == pytest.approx(2 / 3)
    assert figures["area_precision"] == pytest.approx(1.0)
    assert figures["area_f1_iou50"] == pytest.approx(2 * 2 / (2 + 3))
    assert figures["door_recall"] == figures["topology_recall"] == 0.5
    assert figures["door_precision"] == figures["topology_precision"] == 1.0
    # Of the 20 corners the room has 6, four of its own and two jambs.
    assert figures["corner_recall"] == pytest.approx(14 / 20)
    assert figures["corner_precision"] == 1.0


def test_merged_rooms() -> None:
    merged = with_extent(without_area(exact_model(), "A2"), "A1", box(0.0, 0.0, 8.2, 3.0))
    areas = areas_of(merged)
    assert areas.precision == pytest.approx((12.0 / 24.6 + 1.0) / 2)
    # Both rooms lie wholly in the one area.
    assert areas.recall == pytest.approx(1.0)
    assert areas.f1_iou50 == pytest.approx(2 * 1 / (2 + 3))
    assert [match.reference for match in areas.matches] == ["A3"]


def test_a_room_split_in_two() -> None:
    model = exact_model()
    left, right = box(0.0, 0.0, 2.5, 3.0), box(2.5, 0.0, 4.0, 3.0)
    halves = with_extent(model, "A1", left)
    # The second half takes the place of the room beyond, which is lost.
    areas = areas_of(with_extent(halves, "A2", right))
    assert areas.precision == pytest.approx(1.0)
    assert areas.recall == pytest.approx((2.5 / 4.0 + 0.0 + 1.0) / 3)
    assert sorted((m.model, m.reference) for m in areas.matches) == [("A1", "A1"), ("A3", "A3")]
    assert {m.model: m.iou for m in areas.matches}["A1"] == pytest.approx(2.5 / 4.0)


def test_an_invented_door() -> None:
    model = exact_model()
    invented = DoorModel("D9", ("A2", "A3"), (), 0.9, door_estimate(np.array([6.0, 3.1])), 1)
    figures = judge(with_doors(model, (*model.environment.doors, invented)))
    assert figures["door_precision"] == figures["topology_precision"] == pytest.approx(2 / 3)
    assert figures["door_recall"] == figures["topology_recall"] == 1.0


def test_a_door_that_was_only_seen_is_not_asked_for() -> None:
    model = exact_model()
    seen = DoorModel("D9", ("A2", "A3"), (), 0.9, door_estimate(np.array([6.0, 3.1])), 0)
    assert judge(with_doors(model, (*model.environment.doors, seen)))["door_precision"] == 1.0


def test_a_door_half_a_metre_off_is_another_one() -> None:
    model = exact_model()
    for shift, matched in ((0.499, 2), (0.501, 1)):
        doors = list(model.environment.doors)
        doors[0] = replace(doors[0], estimate=door_estimate(np.array([4.1, 1.45 + shift])))
        result = door_metrics(place(with_doors(model, tuple(doors)), R_t_g), REFERENCE)
        assert result is not None
        assert result.detections.matched == matched
        if matched == 2:
            values = {metric.name: metric.value for metric in result.metrics()}
            assert values["door_rmse"] == pytest.approx(shift / np.sqrt(2))


def shifted(reference: ReferenceMap, by: tuple[float, float]) -> ReferenceMap:
    """The reference moved, the trajectory in its frame left where it was."""
    assert reference.walls is not None
    assert reference.doors is not None
    assert reference.areas is not None
    return ReferenceMap(
        walls=reference.walls + np.tile(by, 2),
        doors=tuple(replace(d, p1=d.p1 + by, p2=d.p2 + by) for d in reference.doors),
        areas=tuple(replace(a, polygon=a.polygon + by) for a in reference.areas),
    )


def test_a_shifted_reference() -> None:
    figures = judge(exact_model(), shifted(REFERENCE, (0.06, -0.08)))
    assert figures["corner_rmse"] == pytest.approx(0.1)
    assert figures["door_rmse"] == pytest.approx(0.1)
    assert figures["corner_precision"] == figures["corner_recall"] == 1.0
    assert 0.06 - 1e-9 <= figures["wall_rmse"] <= 0.1 + 1e-9
    assert figures["area_precision"] == pytest.approx(
        np.mean([(w - 0.06) * (h - 0.08) / (w * h) for w, h in ((4, 3), (4, 3), (8.2, 2))])
    )
    # By (0.06, 0.08) with a sigma of 2 cm in area frame and landmark both, and two levers.
    assert 0.5 < figures["nees_landmarks"] < 0.01 / (2 * 0.02**2) / 2


def test_corners_farther_than_the_radius_are_wrong() -> None:
    figures = judge(exact_model(), shifted(REFERENCE, (0.18, 0.18)))
    # 0.2546 m off. What matches is the other side of a wall, 0.02 m x 0.18 m away: both doors'
    # jambs on their farther face, and four places where two rooms have corners back to back.
    assert figures["corner_precision"] == pytest.approx(8 / 20)
    assert figures["door_precision"] == 1.0


def test_segments_far_from_every_wall_are_outliers() -> None:
    lost = shifted(REFERENCE, (100.0, 0.0))
    figures = judge(exact_model(), lost)
    assert figures["wall_outliers"] == 1.0
    assert "wall_rmse" not in figures
    assert figures["area_precision"] == 0.0


def test_what_the_reference_does_not_list_is_left_out() -> None:
    assert REFERENCE.areas is not None
    figures = judge(exact_model(), ReferenceMap(areas=REFERENCE.areas))
    assert set(figures) == {"area_precision", "area_recall", "area_f1_iou50"}
    assert judge(exact_model(), ReferenceMap()) == {}


def test_without_a_common_stamp_nothing_is_measured() -> None:
    later = exact_trajectory()
    later = replace(later, stamps_ns=later.stamps_ns + 10**12)
    assert map_metrics(exact_model(), later, REFERENCE, TRUTH) == ()


def test_unvisited_areas_and_doors_are_not_asked_for() -> None:
    assert REFERENCE.areas is not None
    assert REFERENCE.doors is not None
    reference = replace(
        REFERENCE,
        areas=tuple(replace(a, visited=a.id != "A2") for a in REFERENCE.areas),
        doors=tuple(replace(d, visited=d.id != "D1") for d in REFERENCE.doors),
    )
    figures = judge(without_area(exact_model(), "A2"), reference)
    assert figures["area_recall"] == pytest.approx(1.0)
    assert figures["door_recall"] == 1.0
    assert figures["area_f1_iou50"] == figures["topology_recall"] == 1.0
    # The jambs on the lost room's face are in sight of the first room, yet not its corners.
    assert figures["corner_recall"] == 1.0


def test_only_the_part_that_was_seen_is_asked_for() -> None:
    # A cupboard from wall to wall hides the last 2 m of the corridor's 8.2 m.
    reference = replace(REFERENCE, furniture=np.array([[6.2, 3.2, 6.2, 5.2]]))
    short = with_extent(exact_model(), "A3", box(0.0, 3.2, 6.2, 5.2))
    before = TRUTH.poses[TRUTH.poses[:, 0] < 6.0]
    result = area_metrics(place(short, R_t_g), reference, before)
    assert result is not None
    # The second room is not entered in time: never seen from inside, and left out.
    assert result.seen == 3
    assert result.recall == pytest.approx(1.0, abs=1e-4)


def test_a_room_that_was_never_seen_from_inside_is_left_out() -> None:
    result = area_metrics(place(exact_model(), R_t_g), REFERENCE, TRUTH.poses[:10])
    assert result is not None
    assert (result.asked, result.seen) == (3, 1)


def test_a_narrow_view_asks_for_less() -> None:
    # Looking ahead only, and at most 3 m far, the robot never sees the corridor's near end.
    figures = judge(without_area(exact_model(), "A3"), view=View(3.0, 1.0))
    whole = judge(without_area(exact_model(), "A3"))
    assert figures["corner_recall"] > whole["corner_recall"]


def test_edges_of_matched_areas_only() -> None:
    # The first area of the model lies where nothing is: both its edges are wrong.
    lost = with_extent(exact_model(), "A1", box(100.0, 0.0, 104.0, 3.0))
    result = topology_metrics(place(lost, R_t_g), REFERENCE)
    assert result is not None
    assert result[:4] == (0.0, 0.0, 2, 2)
    assert result.missed == (("A1", "A2"), ("A1", "A3"))


def test_areas_without_an_extent_are_not_counted() -> None:
    empty = with_extent(exact_model(), "A1", np.zeros((0, 2)))
    areas = areas_of(empty)
    assert (areas.found, areas.asked) == (2, 3)
    assert areas.precision == pytest.approx(1.0)
    assert areas.recall == pytest.approx(2 / 3)


def test_corners_are_where_exactly_two_walls_end_together() -> None:
    walls = np.array(
        [
            [0.0, 0.0, 4.0, 0.0],
            [4.004, 0.0, 4.0, 3.0],  # meets the first within a centimetre
            [4.0, 3.0, 0.0, 3.0],  # a corner with the second ...
            [4.0, 3.0, 4.0, 6.0],  # ... but for the third wall there
            [0.0, 3.0, -2.0, 3.05],  # nearly straight on: no corner
            [0.0, 0.0, -1.0, -1.0],  # 45 degrees on: a corner
        ]
    )
    found = end_corners(walls)
    assert found.points == pytest.approx(np.array([[0.0, 0.0], [4.002, 0.0]]))


def test_corners_of_furniture() -> None:
    # A cupboard against the wall y = 0, given by its three free sides.
    reference = ReferenceMap(
        walls=np.array([[0.0, 0.0, 4.0, 0.0]]),
        furniture=np.array([[1, 0, 1, 0.5], [1, 0.5, 2, 0.5], [2, 0.5, 2, 0]], dtype=float),
    )
    found = furniture_corners(reference)
    assert sorted(found.tolist()) == [[1.0, 0.0], [1.0, 0.5], [2.0, 0.0], [2.0, 0.5]]
