"""Areas that prove to be one place once they lie where they are, and doors that part nothing."""

from __future__ import annotations

import numpy as np
import pytest
from test_portals import ACROSS, fresh, strip

from hiermap_cli.config import AreaConfig, DoorConfig
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.areas.common_ground import Bars, Open, grounds, one_place, together
from hiermap_cli.mapping.areas.extents import extents
from hiermap_cli.mapping.areas.rooms import Rooms, decide
from hiermap_cli.mapping.portals import Portal, add_anchor
from hiermap_cli.mapping.topology.freespace import FreeGrid, Region
from hiermap_cli.mapping.topology.places import Places

NO_BARS = Bars(np.zeros((0, 3)), np.zeros(0))


def places_of(*grids, paths=None):
    """Areas with their free space, and paths along X, from and to metres."""
    places = Places(DoorConfig().max_width)
    for i, grid in enumerate(grids):
        places.grids[i] = grid
        first, last = (0.0, 4.0) if paths is None else paths[i]
        places.paths[i] = {(k, 0) for k in range(round(10 * first), round(10 * last))}
    return places


def pairs(places, frames, bars=NO_BARS, *, across=True):
    """The pairs that are one place; across: the robot drove between all of them."""
    frames = np.array(frames, dtype=float)
    ground, sure = (grounds(places, frames, bars, w) for w in (0.8, DoorConfig().max_width))
    n = len(frames)
    driven = {(a, b) for a in range(n) for b in range(a + 1, n)} if across else set()
    is_open = Open(places, frames, bars, DoorConfig().max_width)
    return one_place(ground, sure, driven, 0.5, is_open)


@pytest.mark.parametrize(
    ("x", "theta", "one"),
    [(0.3, 0.0, True), (1.4, 0.3, True), (2.6, 0.0, False), (9.0, 0.0, False)],
)
def test_areas_are_one_that_have_most_of_their_ground_in_common(x, theta, one):
    # The path is told apart from the ground: it is in the far half only.
    places = places_of(strip(), strip(), paths=[(0.2, 1.0), (3.0, 3.8)])
    assert pairs(places, [[1.0, 2.0, 0.0], [1.0 + x, 2.0, theta]]) == ([(0, 1)] if one else [])


def test_an_area_is_another_if_its_path_lies_in_it():
    long = places_of(strip(12.0), strip(4.0), paths=[(0.0, 4.0), (0.0, 1.5)])
    # A third of the smaller one's ground lies in the other, and all of the robot's path.
    assert pairs(long, [[0.0, 0.0, 0.0], [10.5, 0.0, 0.0]]) == [(0, 1)]
    long.paths[1] = {(k, 0) for k in range(20, 40)}
    assert pairs(long, [[0.0, 0.0, 0.0], [10.5, 0.0, 0.0]]) == []


def test_what_lies_behind_a_door_is_not_common():
    """A corridor from which all of a room is seen: one place, but for the door between them."""
    places = places_of(strip(8.0), strip(4.0), paths=[(0.5, 3.5), (0.5, 3.5)])
    frames = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]]
    assert pairs(places, frames) == [(0, 1)]
    door = np.array([[4.0, 0.0, -0.5 * np.pi]])
    assert pairs(places, frames, Bars(door, np.array([3.0]))) == []
    assert pairs(places, frames, Bars(door, np.array([0.9]))) == [(0, 1)]  # a way round it


def test_who_stands_in_a_corridor_does_not_part_it():
    """Each half was seen from its own end, as far as those who stood in the middle let it."""
    halves = [strip(8.0), strip(8.0)]
    for grid, x in zip(halves, (5.0, 3.0), strict=True):
        i = round(10 * x) - grid.first[0]
        middle = grid.passed.shape[1] // 2
        grid.passed[i : i + 6, middle - 3 : middle + 3] = 0  # one who leaves 1.1 m on either side
        grid.passed[:, [0, -1]] = 0  # walls
    places = places_of(*halves, paths=[(0.5, 3.5), (6.0, 7.5)])
    frames = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert pairs(places, frames, across=False) == [(0, 1)]
    door = Bars(np.array([[4.0, 0.0, -0.5 * np.pi]]), np.array([3.0]))
    assert pairs(places, frames, door, across=False) == []


def two_rooms(door):
    """Rooms of 4 x 4 m, side by side, and an opening between them; all of it free where seen."""
    passed = np.zeros((80, 40), np.uint8)
    passed[:38], passed[42:] = 1, 1
    width = round(10 * door)
    passed[:, 20 - width // 2 : 20 - width // 2 + width] = 1
    return FreeGrid(passed, np.zeros_like(passed), (0, -20), scans=1)


@pytest.mark.parametrize(("door", "across", "one"), [
    (1.0, True, True), (1.0, False, False), (3.0, False, True),
])  # fmt: skip
def test_what_was_seen_through_a_door_never_driven_through_is_another_place(door, across, one):
    """From the first room most of the second was seen, in which the robot had been before.

    Where it has driven from one into the other a door would be known; an opening wider than
    any door parts nothing.
    """
    places = places_of(two_rooms(door), two_rooms(0.0), paths=[(0.5, 3.5), (4.5, 7.5)])
    frames = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert pairs(places, frames, across=across) == ([(0, 1)] if one else [])


@pytest.mark.parametrize(("x", "one"), [(21.0, True), (26.0, True), (28.5, False)])
def test_the_halves_of_a_long_place_are_one_if_the_robot_went_along_both(x, one):
    """Corridors of 30 m, less than a third of them common: 9 m, 4 m or 1.5 m of either's path."""
    places = places_of(strip(30.0, 2.0), strip(30.0, 2.0), paths=[(0.0, 30.0), (0.0, 30.0)])
    frames = [[0.0, 0.0, 0.0], [x, 0.0, 0.0]]
    assert pairs(places, frames, across=False) == ([(0, 1)] if one else [])


def test_a_path_beyond_a_door_does_not_tell():
    """The robot went back into the first area, and the filter had it in the second still."""
    places = places_of(strip(4.0), strip(8.0), paths=[(0.5, 3.5), (0.5, 7.9)])
    frames = [[0.0, 0.0, 0.0], [7.5, 0.0, np.pi]]  # the second looks back into the first
    door = np.array([[3.8, 0.0, -0.5 * np.pi]])
    places.paths[1] = {(k, 0) for k in range(2, 36)} | {(k, 0) for k in range(40, 72)}
    assert pairs(places, frames, Bars(door, np.array([3.0]))) == []
    assert pairs(places, frames) == [(0, 1)]


@pytest.mark.parametrize("known", [True, False])
def test_an_area_is_where_it_began_if_no_other_area_is_there(known):
    """A room of 3 m entered by a door at x = 0, and left again by it unnoticed: 5 m beyond."""
    both = FreeGrid(np.ones((90, 20), np.uint8), np.zeros((90, 20), np.uint8), (-60, -10), scans=1)
    corridor = strip(6.0, 2.0)
    places = places_of(both, corridor, paths=[(-5.0, 2.8), (0.5, 5.5)])
    # The other area is the corridor, or else lies somewhere else.
    frames = np.array([[0.0, 0.0, 0.0], [-6.0 if known else 50.0, 0.0, 0.0]])
    bars = Bars(np.array([[0.0, 0.0, 0.5 * np.pi]]), np.array([2.0]))
    places.paths[0].discard((0, 0))
    first, other = grounds(places, frames, bars, 0.8)
    if known:
        assert 0.0 < first.way[:, 0].min() < first.way[:, 0].max() < 3.0
        assert not np.intersect1d(first.seen, other.seen).size
    else:
        # Nobody else has seen either part: the larger one tells.
        assert first.way[:, 0].max() < 0.0


def test_common_ground_is_counted_once():
    places = places_of(strip(), strip(), strip())
    ground = grounds(places, np.array([[0.0, 0, 0], [0.0, 0, 0], [50.0, 0, 0]]), NO_BARS, 0.8)
    assert together(ground[:1]) == pytest.approx(12.0)
    assert together(ground[:2]) == pytest.approx(12.0)
    assert together(ground) == pytest.approx(24.0)
    assert together([]) == 0.0


def test_an_area_without_anything_meets_none():
    places = places_of(strip())
    assert pairs(places, [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) == []


@pytest.mark.parametrize("theta", [0.0, 0.4, -2.0])
def test_bars_lie_in_every_frame_where_the_doors_are(theta):
    frame = np.array([3.0, -1.0, theta])
    doors = se2.compose(frame, np.array([[1.0, 2.0, 0.5 * np.pi], [30.0, 0.0, 0.0]]))
    (bar,) = Bars(doors, np.array([0.8, 0.8])).within(frame, np.array([[0.0, 0.0], [4.0, 4.0]]))
    assert bar == pytest.approx(np.array([[1.0, 1.1], [1.0, 2.9]]))


def three_areas():
    """A room, what is again a part of the room, and another room: doors at x = 4 and x = 3.8."""
    maps = []
    area, _ = add_anchor(fresh(), 0)
    area, out = add_anchor(area, 1)
    maps.append(area)
    second, into = add_anchor(fresh(), 1)
    second, out2 = add_anchor(second, 2)
    third, into2 = add_anchor(fresh(), 2)
    maps += [second, third]
    at = np.array([4.0, 0.0, 0.0])
    portals = [
        Portal(0, out, 1, into, "door", se2.compose(at, ACROSS), 0.9, 2.0, 0.0),
        Portal(1, out2, 2, into2, "door", se2.compose(at - [0.2, 0.0, 0.0], ACROSS), 0.9, 2.0, 0.0),
    ]
    return maps, portals


def decided(places, frames, *, placed):
    maps, portals = three_areas()
    frames = np.array(frames, dtype=float)
    return decide(maps, portals, places, frames, DoorConfig(), AreaConfig(), placed=placed)


def test_a_door_that_parts_nothing_is_none():
    narrow = 1.6  # no way round a door of 0.9 m
    places = places_of(
        strip(6.8, width=narrow), strip(6.8, width=narrow), strip(4.0, narrow),
        paths=[(0.2, 3.5), (0.2, 3.5), (0.2, 3.5)],
    )  # fmt: skip
    # The first two are seen from the same place: what parts them lies behind both.
    frames = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [20.0, 0.0, 0.0]]
    rooms = decided(places, frames, placed=True)
    assert rooms.parts == ((0, 1), (2,))
    assert [(r.portal, r.reason) for r in rooms.refused] == [
        (0, "the robot came round it another way")
    ]
    assert len(rooms.bars.frames) == 1
    # Areas that are known less well are not taken for one by what they seem to share.
    assert decided(places, frames, placed=False).parts == ((0,), (1,), (2,))


def test_a_door_away_from_its_area_is_the_one_that_is_there_already():
    """The robot left the second area unnoticed, and came through the first door once more."""
    maps, portals = three_areas()
    third = portals[1]
    places = places_of(strip(4.0), strip(4.0), strip(4.0), paths=[(0.2, 3.8)] * 3)
    # Both doors lie at x = 4 of the first area; the second area is elsewhere.
    frames = np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    away = se2.compose(np.array([-16.0, 0.0, 0.0]), ACROSS)
    portals[1] = third.__class__(1, third.anchor_a, 2, third.anchor_b, "door", away, 0.9, 2.0, 0.0)
    portals[0] = third.__class__(
        0, portals[0].anchor_a, 2, third.anchor_b, "door", portals[0].R_anchor_d, 0.9, 2.0, 0.0
    )
    rooms = decide(maps, portals, places, frames, DoorConfig(), AreaConfig(), placed=True)
    assert rooms.door == (0, 0)
    assert [p.kind for p in rooms.portals] == ["door", "open"]


def extent_of(grid, path, *, furniture=1.2):
    places = Places(DoorConfig().max_width)
    places.grids, places.paths = {0: grid}, {0: {tuple(cell) for cell in path}}
    config = AreaConfig(furniture=furniture)
    still = np.zeros((1, 3))
    (one,) = extents(Rooms(((0,),), (), (), ()), [still], still, [fresh()], places, config, NO_BARS)
    return one.polygon


def test_a_room_that_was_only_seen_through_a_door_is_left_out():
    mask = np.zeros((120, 50), dtype=np.uint8)
    mask[:60, :] = 1
    mask[60:64, 20:33] = 1  # 1.3 m wide
    mask[64:, :] = 1
    grid = FreeGrid(mask, np.zeros_like(mask), (0, 0), scans=1)
    here = [(k, 25) for k in range(10, 50)]
    assert extent_of(grid, here)[:, 0].max() < 7.0
    there = [(k, 25) for k in range(10, 100)]
    assert extent_of(grid, there)[:, 0].max() == pytest.approx(12.0, abs=0.11)


def test_an_alcove_that_is_no_area_belongs_to_its_room():
    mask = np.zeros((90, 50), dtype=np.uint8)
    mask[:60, :] = 1
    mask[60:64, 20:33] = 1
    mask[64:84, 16:37] = 1  # 2.0 m x 2.1 m
    grid = FreeGrid(mask, np.zeros_like(mask), (0, 0), scans=1)
    polygon = extent_of(grid, [(k, 25) for k in range(10, 50)])
    assert polygon[:, 0].max() == pytest.approx(8.4, abs=0.11)


def test_ground_parted_from_an_area_goes_to_the_other_that_has_seen_it():
    """The first sees all of a corridor of 12 m; the second has been in its middle only."""
    places = places_of(strip(12.0, 2.0), strip(4.0, 2.0), paths=[(0.2, 4.0), (0.2, 3.8)])
    places.grids[1] = FreeGrid(
        np.ones((80, 20), np.uint8), np.zeros((80, 20), np.uint8), (0, -10), scans=1
    )
    frames = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    places.paths[0] |= {(k, 0) for k in range(112, 118)}  # and once more at its end
    rooms = Rooms(((0,), (1,)), (), (), ())
    still = np.zeros((1, 3))
    first, second = extents(
        rooms, [still, still], frames, [fresh(), fresh()], places, AreaConfig(), NO_BARS
    )
    assert first.polygon[:, 0].max() == pytest.approx(4.0, abs=0.3)
    assert second.polygon[:, 0].max() == pytest.approx(8.0, abs=0.11)


def test_regions_of_no_cells_are_left_as_they_are():
    from hiermap_cli.mapping.areas.extents import entered

    nothing = Region(np.zeros((0, 0), dtype=bool), (0, 0))
    assert entered(nothing, np.zeros((0, 2)), 1.7, 5.0) is nothing
