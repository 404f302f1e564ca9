"""The free space of an area: what beams have passed, its region within doors, its outline."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiermap_cli.config import AreaConfig
from hiermap_cli.mapping.areas.extents import area_kind
from hiermap_cli.mapping.areas.outlines import outline, simplified
from hiermap_cli.mapping.topology.freespace import (
    CELL,
    FreeGrid,
    Region,
    closed,
    half_width,
)


def ends_in_box(origin, low=(0.0, 0.0), high=(6.0, 4.0), beams=360):
    """Where beams all around end on the walls of a box."""
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False) + 1e-4  # none along an axis
    d = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    t = np.where(d > 0, (np.array(high) - origin) / d, (np.array(low) - origin) / d)
    return origin + t.min(axis=1)[:, None] * d


def area_of(polygon):
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def seen_box(*origins):
    grid = FreeGrid()
    for origin in origins:
        grid.add(np.array(origin), ends_in_box(np.array(origin)))
    return grid


def region_of(mask, first=(0, 0)):
    return Region(np.array(mask, dtype=bool), first)


def test_a_room_seen_all_around_has_its_outline():
    grid = seen_box((2.0, 2.0), (4.0, 1.5))
    region = grid.region(np.array([[2.0, 2.0], [4.0, 1.5]]), [], 0.8)
    polygon = outline(closed(region, 0.5), 0.1)
    assert area_of(polygon) == pytest.approx(24.0, rel=0.12)
    assert polygon.min() > -0.2
    assert polygon.max(axis=0) == pytest.approx([6.0, 4.0], abs=0.3)
    assert region.contains(np.array([3.0, 3.0]))
    assert not region.contains(np.array([6.5, 3.0]))


def test_what_lies_beyond_a_door_is_another_area():
    grid = FreeGrid()
    origin = np.array([4.0, 2.0])
    grid.add(origin, ends_in_box(origin))  # one box, told in two by a barrier at x = 3
    barrier = np.array([[3.0, -0.2], [3.0, 4.2]])
    region = grid.region(np.array([[4.0, 2.0], [5.0, 2.0]]), [barrier], 0.8)
    assert region.contains(np.array([4.5, 1.0]))
    assert not region.contains(np.array([1.5, 2.0]))


@pytest.mark.parametrize("turn", [0.0, 0.3, 0.7853981633974483, 1.1])
def test_no_barrier_leaks_however_it_is_turned(turn):
    grid = seen_box((3.0, 2.0))
    d = 6.0 * np.array([np.cos(turn), np.sin(turn)])
    middle = np.array([3.0, 2.0])
    n = np.array([-d[1], d[0]]) / 6.0
    start = middle + 0.5 * n
    region = grid.region(start[None], [np.array([middle - d, middle + d])], 0.3)
    assert region.contains(start)
    v = (region.centres() - middle) @ n
    assert v.min() > -0.15


def test_the_larger_part_of_the_path_tells_the_side():
    grid = seen_box((3.0, 2.0))
    barrier = np.array([[3.0, -0.2], [3.0, 4.2]])
    path = np.array([[2.5, 2.0], *[[x, 2.0] for x in np.arange(3.5, 5.5, 0.1)]])
    region = grid.region(path, [barrier], 0.8)
    assert region.contains(np.array([5.0, 2.0]))
    assert not region.contains(np.array([1.0, 2.0]))


def test_a_gap_that_the_robot_did_not_use_is_left_out():
    mask = np.zeros((60, 40), dtype=bool)
    mask[:28, :] = mask[32:, :] = True
    mask[28:32, 18:22] = True  # 0.4 m wide
    grid = FreeGrid(passed=mask.astype(np.uint8), ended=np.zeros(mask.shape, np.uint8))
    path = np.array([[1.0, 2.0]])
    assert not grid.region(path, [], 0.8).contains(np.array([5.0, 2.0]))
    assert grid.region(path, [], 0.2).contains(np.array([5.0, 2.0]))
    through = np.array([[x, 2.0] for x in np.arange(1.0, 5.0, 0.05)])
    assert grid.region(through, [], 0.8).contains(np.array([5.0, 2.0]))


def test_nothing_seen_is_nothing():
    region = FreeGrid().region(np.zeros((0, 2)), [], 0.8)
    assert region.area() == 0.0
    assert outline(closed(region, 0.5), 0.1).shape == (0, 2)
    assert half_width(region) == 0.0
    grid = FreeGrid()
    grid.add(np.zeros(2), np.zeros((0, 2)))
    assert grid.scans == 0


def test_counts_saturate_and_the_grid_does_not_grow_with_time():
    grid = FreeGrid()
    origin = np.array([2.0, 2.0])
    for _ in range(300):
        grid.add(origin, ends_in_box(origin, beams=60))
    assert grid.passed.max() == 255
    assert grid.passed.shape == seen_box((2.0, 2.0)).passed.shape


def test_a_wall_is_no_free_space_though_some_beams_went_astray():
    grid = FreeGrid()
    for _ in range(5):
        grid.add(np.array([0.05, 0.05]), np.array([[2.05, 0.05]]))
    grid.add(np.array([0.05, 0.05]), np.array([[3.05, 0.05]]))
    i = 20 - grid.first[0]
    assert grid.ended[i].max() == 5
    assert not grid.free()[i].any()


@given(x=st.floats(-20, 20), y=st.floats(-20, 20), theta=st.floats(-3.1, 3.1))
def test_a_grid_moved_to_another_frame_covers_the_same_ground(x, y, theta):
    grid = seen_box((3.0, 2.0))
    R = np.array([x, y, theta])
    moved = grid.moved(R)
    c, s = np.cos(theta), np.sin(theta)
    start = R[:2] + np.array([[3.0, 2.0]]) @ np.array([[c, s], [-s, c]])
    before = grid.region(np.array([[3.0, 2.0]]), [], 0.3).area()
    assert moved.region(start, [], 0.3).area() == pytest.approx(before, rel=0.05)


def test_joined_grids_hold_what_both_hold():
    one, two = seen_box((2.0, 2.0)), seen_box((2.0, 2.0)).moved(np.array([3.0, 0.0, 0.0]))
    both = one.joined(two)
    assert both.scans == 2
    for point in ([1.0, 2.0], [8.0, 2.0]):
        i, j = np.floor(np.array(point) / CELL).astype(int) - both.first
        assert both.passed[i, j] > 0
    i, j = np.floor(np.array([4.0, 2.0]) / CELL).astype(int) - both.first
    assert both.passed[i, j] == 2
    assert one.joined(FreeGrid()) is one


def test_holes_and_narrow_gaps_are_filled_and_the_largest_piece_is_taken():
    mask = np.zeros((60, 30), dtype=bool)
    mask[:40, :20] = True
    mask[10:13, 5:8] = False
    mask[20:22, :15] = False  # 0.2 m between pieces of furniture
    mask[50:53, 25:28] = True
    filled = closed(region_of(mask), 0.5)
    assert filled.area() == pytest.approx(40 * 20 * CELL**2, rel=0.02)


def test_the_outline_runs_counterclockwise_about_cells_that_touch_at_a_corner():
    mask = np.zeros((4, 4), dtype=bool)
    mask[0:2, 0:2] = mask[2:4, 2:4] = True
    mask[1, 2] = True
    polygon = outline(region_of(mask, (10, -5)), 0.0)
    assert area_of(polygon) > 0.0
    assert polygon.min(axis=0) == pytest.approx([1.0, -0.5])


def test_thinning_keeps_corners_and_drops_points_on_lines():
    ring = np.array([[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]], dtype=float)
    assert sorted(map(tuple, simplified(ring, 0.01).tolist())) == [(0, 0), (0, 2), (2, 0), (2, 2)]


@pytest.mark.parametrize(
    ("size", "kind"), [((120, 20), "corridor"), ((40, 30), "room"), ((15, 10), "unknown")]
)
def test_kinds_by_shape(size, kind):
    assert area_kind(region_of(np.ones(size)), AreaConfig()) == kind


def test_a_region_is_trimmed_to_its_cells():
    mask = np.zeros((9, 7), dtype=bool)
    mask[2:5, 3:6] = True
    mask[3, 4] = False
    region = region_of(mask, (-4, 10))
    trimmed = region.trimmed()
    assert trimmed.mask.shape == (3, 3)
    assert np.array_equal(trimmed.centres(), region.centres())
    assert trimmed.bounds() == pytest.approx(np.array([[-0.2, 1.3], [0.1, 1.6]]))
    assert region_of(np.zeros((4, 4))).trimmed().mask.size == 0
