from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from hiermap_cli.evaluation.visibility import (
    ALL_AROUND,
    View,
    first_hits,
    in_sight,
    star,
    viewpoints,
)

ROOM = np.array([[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]], dtype=float)
ORIGIN = np.array([[1.0, 1.0, 0.0]])


def sees(target: tuple[float, float], blockers: np.ndarray, view: View = ALL_AROUND) -> bool:
    return bool(in_sight(ORIGIN, np.array([target]), blockers, view)[0, 0])


def test_walls_hide_what_is_behind_them() -> None:
    screen = np.array([[2.0, 0.5, 2.0, 1.5]])
    assert not sees((3.0, 1.0), screen)
    assert sees((1.9, 1.0), screen)
    assert sees((3.0, 2.5), screen)
    assert sees((3.0, 1.0), np.zeros((0, 4)))


def test_a_corner_is_not_hidden_by_its_own_walls() -> None:
    for corner in ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)):
        assert sees(corner, ROOM)


def test_reach_and_field_of_view() -> None:
    nothing = np.zeros((0, 4))
    assert sees((3.0, 1.0), nothing, View(2.0))
    assert not sees((3.1, 1.0), nothing, View(2.0))
    ahead = View(math.inf, math.pi)
    assert sees((1.0, 2.0), nothing, ahead)
    assert not sees((0.9, 2.0), nothing, ahead)
    behind = np.array([[1.0, 1.0, 3.0]])  # looks the other way, past the wrap
    assert in_sight(behind, np.array([[0.0, 1.3]]), nothing, ahead).all()


def test_distances_along_rays() -> None:
    directions = np.array([[1.0, 0.0], [0.0, -1.0], [-math.sqrt(0.5), math.sqrt(0.5)]])
    hits = first_hits(np.ones((3, 2)), directions, ROOM)
    assert hits == pytest.approx([3.0, 1.0, math.sqrt(2.0)])
    assert first_hits(np.ones((3, 2)), directions, np.zeros((0, 4))).tolist() == [math.inf] * 3
    along = first_hits(np.array([[0.0, 0.0]]), np.array([[1.0, 0.0]]), ROOM[:1])
    assert along.tolist() == [math.inf]


def test_the_star_of_a_convex_room_is_the_room() -> None:
    seen = shapely.Polygon(star(ORIGIN[0], ROOM, ALL_AROUND))
    assert seen.area == pytest.approx(12.0, abs=1e-4)


def test_the_star_behind_a_screen_is_a_shadow() -> None:
    # From (1, 1) the screen x = 2, 0.5 <= y <= 1.5 hides a trapezium: 1 m wide there, 3 m at x = 4
    # but for what the floor plan cuts off below y = 0 (from x = 3 on: a triangle of 0.25 m2).
    screen = np.vstack((ROOM, [[2.0, 0.5, 2.0, 1.5]]))
    seen = shapely.Polygon(star(ORIGIN[0], screen, ALL_AROUND))
    assert seen.area == pytest.approx(12.0 - (4.0 - 0.25), abs=1e-3)


def test_the_star_of_a_narrow_view_is_a_wedge() -> None:
    seen = shapely.Polygon(star(ORIGIN[0], ROOM, View(1.0, math.pi / 2)))
    assert seen.area == pytest.approx(math.pi / 4, rel=1e-3)


def test_viewpoints_are_thinned_but_keep_every_turn() -> None:
    straight = np.column_stack((np.linspace(0, 10, 1001), np.zeros((1001, 2))))
    assert len(viewpoints(straight)) == pytest.approx(40, abs=2)
    turning = np.column_stack((np.zeros((629, 2)), np.linspace(0, 2 * math.pi, 629)))
    assert len(viewpoints(turning)) == pytest.approx(18, abs=1)
    assert len(viewpoints(np.zeros((0, 3)))) == 0
