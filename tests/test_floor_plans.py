"""Floor plans: polygons, walls with thickness, doors with jambs, and every fault at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from world_cases import ONE_ROOM, TWO_ROOMS, spec_of, world_of

from hiermap_cli.errors import ConfigurationError
from hiermap_cli.simulation.floors import AREAS_PER_BLOCK, office_floor
from hiermap_cli.simulation.plan import build_plan
from hiermap_cli.simulation.polygons import (
    contains,
    counterclockwise,
    crossings,
    drawn_in,
    edges,
    is_simple,
    point_distances,
    signed_area,
    way_clearance,
)
from hiermap_cli.simulation.world import build_world, load_world

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
L_SHAPE = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 2.0], [2.0, 2.0], [2.0, 5.0], [0.0, 5.0]])


def plan_of(base, **changes):
    faults = []
    plan = build_plan(spec_of(base, **changes), faults)
    assert plan is not None, faults
    return plan


def as_set(segments):
    """Segments without their direction, rounded."""
    return {tuple(sorted([tuple(s[:2]), tuple(s[2:])])) for s in np.round(segments, 6).tolist()}


# --- polygons ---


def test_area_and_orientation():
    assert signed_area(SQUARE) == 16.0
    assert signed_area(SQUARE[::-1]) == -16.0
    assert signed_area(counterclockwise(SQUARE[::-1])) == 16.0
    assert signed_area(L_SHAPE) == 18.0


def test_drawing_in_moves_every_edge_by_the_distance():
    inner = drawn_in(L_SHAPE, 0.25)
    for outer_edge, inner_edge in zip(edges(L_SHAPE), edges(inner), strict=True):
        along = outer_edge[2:] - outer_edge[:2]
        left = np.array([-along[1], along[0]]) / np.hypot(*along)
        for corner in (inner_edge[:2], inner_edge[2:]):
            assert np.dot(corner - outer_edge[:2], left) == pytest.approx(0.25)
    assert np.allclose(drawn_in(inner, -0.25), L_SHAPE)


@given(st.floats(-1.0, 7.0), st.floats(-1.0, 6.0))
def test_contains_is_the_rule_of_the_shape(x, y):
    inside = (0 < x < 6 and 0 < y < 2) or (0 < x < 2 and 0 < y < 5)
    near_edge = point_distances(np.array([[x, y]]), edges(L_SHAPE)).min() < 1e-9
    assert near_edge or contains(L_SHAPE, np.array([[x, y]]))[0] == inside


def test_crossings_say_where():
    a = np.array([[0.0, 0.0, 4.0, 0.0]])
    b = np.array([[1.0, -1.0, 1.0, 1.0], [4.0, 0.0, 4.0, 1.0], [5.0, -1.0, 5.0, 1.0]])
    assert np.allclose(crossings(a, b), [[0.25, 1.0, np.nan]], equal_nan=True)


@pytest.mark.parametrize(
    ("corners", "simple"),
    [
        (SQUARE, True),
        (L_SHAPE, True),
        (SQUARE[[0, 2, 1, 3]], False),  # crosses itself
        (SQUARE[[0, 1, 1, 2]], False),  # a corner twice
        (np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]]), False),  # a spike
        (np.array([[0.0, 0.0], [4.0, 0.0], [2.0, 0.0]]), False),  # on one line
        (np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [2.0, 0.0], [0.0, 3.0]]), False),  # touches
    ],
)
def test_simple_polygons(corners, simple):
    assert is_simple(corners) == simple


def test_clearance_of_a_way():
    wall = np.array([[0.0, 0.0, 2.0, 0.0]])
    ways = np.array([[0.0, 1.0, 2.0, 1.0], [1.0, -1.0, 1.0, 1.0], [3.0, -1.0, 3.0, 1.0]])
    assert np.allclose(way_clearance(ways, wall), [1.0, 0.0, 1.0])


# --- plans ---


def test_a_room_is_its_middle_lines_drawn_in_by_half_the_wall():
    plan = plan_of(ONE_ROOM)
    assert as_set(plan.walls) == {
        ((0.1, 0.1), (5.9, 0.1)),
        ((5.9, 0.1), (5.9, 3.9)),
        ((0.1, 3.9), (5.9, 3.9)),
        ((0.1, 0.1), (0.1, 3.9)),
    }


def test_a_door_cuts_both_faces_and_has_jambs_as_deep_as_the_wall():
    plan = plan_of(TWO_ROOMS)
    walls = as_set(plan.walls)
    for x in (5.9, 6.1):  # both faces of the wall between the rooms, above and below the door
        assert ((x, 0.1), (x, 1.5)) in walls
        assert ((x, 2.5), (x, 3.9)) in walls
    for y in (1.5, 2.5):  # the jambs
        assert ((5.9, y), (6.1, y)) in walls
    assert len(plan.walls) == 12
    door = plan.doors[0]
    assert as_set([[*door.p1, *door.p2]]) == {((6.0, 1.5), (6.0, 2.5))}


def test_a_passage_as_wide_as_a_corridor_leaves_single_walls():
    corridor = {
        "areas": [{"id": "A", "box": [0, 0, 6, 2.2]}, {"id": "B", "box": [6, 0, 12, 2.2]}],
        "doors": [{"id": "D", "areas": ["A", "B"], "at": [6, 1.1], "width": 2.0}],
    }
    assert as_set(plan_of(TWO_ROOMS, **corridor).walls) == {
        ((0.1, 0.1), (11.9, 0.1)),
        ((0.1, 2.1), (11.9, 2.1)),
        ((0.1, 0.1), (0.1, 2.1)),
        ((11.9, 0.1), (11.9, 2.1)),
    }


def test_walls_between_areas_may_differ_in_thickness():
    areas = [{**TWO_ROOMS["areas"][0], "wall_thickness": 0.1}, TWO_ROOMS["areas"][1]]
    door = plan_of(TWO_ROOMS, areas=areas).doors[0]
    assert np.ptp(door.opening[:, 0]) == pytest.approx(0.15)


def test_the_free_side_is_on_the_left_of_every_face():
    pillars = [{"box": [2.0, 1.0, 2.5, 1.5]}, {"box": [5.5, 0.0, 6.0, 0.6]}]
    furniture = [{"box": [8.0, 3.0, 9.0, 3.5], "turn": 0.4}]
    plan = plan_of(TWO_ROOMS, walls=pillars, furniture=furniture)
    faces = plan.faces()
    along = faces[:, 2:] - faces[:, :2]
    left = np.column_stack((-along[:, 1], along[:, 0])) / np.hypot(*along.T)[:, None]
    middle = 0.5 * (faces[:, :2] + faces[:, 2:])

    def free(points):
        solid = np.zeros(len(points), dtype=bool)
        for low, high in (([2.0, 1.0], [2.5, 1.5]), ([5.5, 0.0], [6.0, 0.6])):
            solid |= ((points > low) & (points < high)).all(axis=1)
        solid |= contains(plan.furniture[::-1, :2], points)
        return plan.indoors(points) & ~solid

    assert free(middle + 1e-3 * left).all()
    assert not free(middle - 1e-3 * left).any()


def test_a_pillar_against_a_wall_cuts_it_and_meets_it_at_corners():
    walls = as_set(plan_of(ONE_ROOM, walls=[{"box": [2.0, 0.0, 3.0, 0.5]}]).walls)
    assert ((0.1, 0.1), (2.0, 0.1)) in walls
    assert ((3.0, 0.1), (5.9, 0.1)) in walls
    assert ((2.0, 0.1), (2.0, 0.5)) in walls
    assert len(walls) == 8


def test_outer_walls_are_there_only_with_a_door_to_the_outside():
    doors = [*TWO_ROOMS["doors"], {"id": "P", "areas": ["outside", "A"], "at": [0.0, 2.0]}]
    plan = plan_of(TWO_ROOMS, doors=doors)
    assert ((-0.1, -0.1), (10.1, -0.1)) in as_set(plan.walls)  # one outer wall over both rooms
    assert plan.doors[1].areas == ("outside:P", "A")
    assert np.abs(plan_of(TWO_ROOMS).walls[:, :2] - [5.0, 2.0]).max() < 5.0


def test_a_floor_of_blocks_has_ten_areas_and_one_loop_a_block():
    for blocks in (1, 5):
        plan = office_floor(blocks, np.random.default_rng(3)).plan
        assert len(plan.areas) == AREAS_PER_BLOCK * blocks
        # Connected, with edges - nodes + 1 independent loops.
        assert len(plan.doors) - len(plan.areas) + 1 == blocks
        group = {area.id: area.id for area in plan.areas}
        for door in plan.doors:
            old, new = group[door.areas[0]], group[door.areas[1]]
            group = {name: new if g == old else g for name, g in group.items()}
        assert len(set(group.values())) == 1


def test_floors_of_one_seed_are_equal_and_of_two_are_not():
    walls = [office_floor(2, np.random.default_rng(seed)).plan.walls for seed in (4, 4, 5)]
    assert np.array_equal(walls[0], walls[1])
    assert walls[0].shape != walls[2].shape or not np.array_equal(walls[0], walls[2])


# --- faults ---


def faults_of(base, **changes):
    with pytest.raises(ConfigurationError) as caught:
        world_of(base, **changes)
    return caught.value.faults


@pytest.mark.parametrize(
    ("changes", "place", "what"),
    [
        ({"areas": [{"id": "A", "box": [0, 0, 6, 4]}] * 2}, "areas[1].id", "taken"),
        ({"areas": [{"id": "A", "box": [0, 0, 0.1, 4]}]}, "areas[0]", "nothing is left"),
        (
            {"areas": [{"id": "A", "polygon": [[0, 0], [6, 4], [6, 0], [0, 4]]}]},
            "areas[0]",
            "crosses",
        ),
        (
            {"areas": [{"id": "A", "box": [0, 0, 6, 4]}, {"id": "B", "box": [5, 0, 9, 4]}]},
            "areas",
            "overlap",
        ),
        (
            {"areas": [{"id": "A", "box": [0, 0, 6, 4]}, {"id": "B", "box": [1, 1, 2, 2]}]},
            "areas",
            "overlap",
        ),
        ({"doors": [{"id": "D", "areas": ["A", "C"], "at": [6, 2]}]}, "doors[0].areas", "'C'"),
        ({"doors": [{"id": "D", "areas": ["A", "A"], "at": [6, 2]}]}, "doors[0].areas", "two"),
        ({"doors": [{"id": "D", "areas": ["A", "B"], "at": [3, 2]}]}, "doors[0].at", "no wall"),
        ({"doors": [{"id": "D", "areas": ["A", "B"], "at": [3, 4]}]}, "doors[0].at", "share"),
        (
            {"doors": [{"id": "D", "areas": ["A", "B"], "at": [6, 2], "width": 4}]},
            "doors[0].width",
            "more than",
        ),
        (
            {"doors": [{"id": "D", "areas": ["A", "outside"], "at": [6, 2]}]},
            "doors[0].areas",
            "outside",
        ),
        ({"furniture": [{"box": [5.5, 1, 6.5, 2]}]}, "furniture[0]", "inside one area"),
        ({"furniture": [{"box": [2, 1.8, 3, 2.2]}]}, "way_points[1]", "radius 0.2 m"),
        ({"doors": []}, "way_points[1]", "comes within"),
        ({"way_points": [[1, 2], [20, 2]]}, "way_points[1].at", "in no area"),
        ({"lifts": [{"at": 500.0, "to": [2, 2, 0]}]}, "lifts[0].at", "drives from"),
        ({"lifts": [{"at": 2.0, "to": [20, 2, 0]}]}, "lifts[0].to", "in no area"),
        (
            {"odometry": {"bends": [{"after": 1, "bend": [0.4, 0, 0.1]}]}},
            "odometry.bends[0].after",
            "no way point",
        ),
    ],
)
def test_each_fault_is_named_with_its_place(changes, place, what):
    assert any(f.startswith(place) and what in f for f in faults_of(TWO_ROOMS, **changes))


def test_faults_of_a_plan_are_listed_together():
    faults = faults_of(
        TWO_ROOMS,
        doors=[*TWO_ROOMS["doors"], {"id": "D", "areas": ["A", "C"], "at": [6, 2]}],
        furniture=[{"box": [5.5, 1, 6.5, 2]}],
        walls=[{"polygon": [[0, 0], [1, 1], [1, 0], [0, 1]]}],
        lifts=[{"at": 500.0, "to": [2, 2, 0]}],
    )
    places = [fault.split(":")[0] for fault in faults]
    expected = ["walls[0]", "doors[1].id", "doors[1].areas", "furniture[0]", "lifts[0].at"]
    assert places == expected


def test_faults_of_a_file_are_listed_with_line_and_path(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(
        "areas:\n"
        "  - {id: A, box: [0, 0, 6]}\n"
        "  - {id: B, box: [0, 0, 1, 1], kind: hall}\n"
        "  - {id: C, box: [0, 0, 1, 1], polygon: [[0, 0], [1, 0], [1, 1]]}\n"
        "way_points: [[1, 1], [2]]\n"
        "laser: {beams: 1e3, sigma: -1, rang: 3}\n"
    )
    with pytest.raises(ConfigurationError) as caught:
        load_world(path)
    places = [": ".join(fault.split(": ")[:2]) for fault in caught.value.faults]
    assert places == [
        "line 2: areas[0].box[3]",
        "line 3: areas[1].kind",
        "line 4: areas[2]",
        "line 5: way_points[1].at[1]",
        "line 6: laser.beams",
        "line 6: laser.rang",
        "line 6: laser.sigma",
    ]
    assert "unknown key" in caught.value.faults[5]


def test_faults_of_the_plan_and_of_the_journey_have_their_lines(tmp_path):
    path = tmp_path / "bad.yaml"
    areas = "areas:\n  - {id: K, box: [0, 0, 6, 4]}\n  - id: L\n    box: [6, 0, 9, 4]\n"
    path.write_text(
        areas.replace("[6, 0", "[5, 0") + "doors:\n"
        "  - {id: D, areas: [K, M], at: [6, 2]}\n"
        "  - id: E\n"
        "    areas: [K, outside]\n"
        "    at: [0, 2]\n"
        "    width: 9\n"
        "  - {id: F, areas: [K, outside], at: [3, 2]}\n"
        "way_points: [[1, 1], [2, 1]]\n"
    )
    with pytest.raises(ConfigurationError) as caught:
        load_world(path)
    assert caught.value.faults == [
        "line 3: areas[1]: 'K' and 'L' overlap",
        "line 6: doors[0].areas: there is no area 'M'",
        "line 10: doors[1].width: 9 m is more than the wall has there",
        "line 11: doors[2].at: no wall of 'K' within 0.05 m",
    ]
    path.write_text(areas + "way_points:\n  - [1, 1]\n  - [8, 2]\n  - at: [20, 2]\n")
    with pytest.raises(ConfigurationError) as caught:
        load_world(path)
    places = [": ".join(fault.split(": ")[:2]) for fault in caught.value.faults]
    assert places == [
        "line 7: way_points[1]",
        "line 8: way_points[2]",
        "line 8: way_points[2].at",
    ]


def test_a_world_without_areas_or_way_points_is_refused(tmp_path):
    path = tmp_path / "empty.yaml"
    path.write_text("areas: []\nway_points: [[0, 0]]\n")
    with pytest.raises(ConfigurationError, match="areas is empty"):
        load_world(path)


def test_the_name_of_the_file_is_in_the_message():
    with pytest.raises(ConfigurationError, match=r"plan\.yaml: .*overlap"):
        build_world(
            spec_of(ONE_ROOM, areas=[*ONE_ROOM["areas"], {"id": "B", "box": [1, 1, 2, 2]}]),
            "plan.yaml",
        )
