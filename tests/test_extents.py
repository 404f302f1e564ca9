"""Where areas are: ground that two of them have seen."""

from __future__ import annotations

import numpy as np
import pytest

from hiermap_cli.config import AreaConfig, DoorConfig
from hiermap_cli.estimation.stochastic_map import initial_map
from hiermap_cli.mapping.area_map import EMPTY, AreaMap
from hiermap_cli.mapping.areas.extents import extents
from hiermap_cli.mapping.areas.rooms import Rooms
from hiermap_cli.mapping.topology.freespace import FreeGrid
from hiermap_cli.mapping.topology.places import Places

AREA = AreaMap(initial_map(np.zeros(3), np.zeros((3, 3)), np.zeros(0), np.zeros((0, 0))), EMPTY)


def free(length, width=3.0):
    """Free space from x = 0 to `length`, about the X axis."""
    n, m = round(length / 0.1), round(width / 0.1)
    return FreeGrid(np.ones((n, m), np.uint8), np.zeros((n, m), np.uint8), (0, -m // 2), scans=1)


def two_areas(seen_by_first):
    """Two areas of 4 m, the second 4 m behind the first, which sees on into it."""
    places = Places(DoorConfig().max_width)
    places.grids = {0: free(seen_by_first), 1: free(4.0)}
    places.paths = {i: {(k, 0) for k in range(5, 36)} for i in (0, 1)}
    rooms = Rooms(((0,), (1,)), (), (), ())
    still = np.zeros((1, 3))
    frames = np.array([[1.0, 2.0, 0.4], [1.0 + 4.0 * np.cos(0.4), 2.0 + 4.0 * np.sin(0.4), 0.4]])
    return extents(rooms, [still, still], frames, [AREA, AREA], places, AreaConfig())


def test_areas_that_see_no_other_ground_keep_theirs():
    for one in two_areas(4.0):
        assert one.polygon.min(axis=0) == pytest.approx([0.0, -1.5], abs=0.11)
        assert one.polygon.max(axis=0) == pytest.approx([4.0, 1.5], abs=0.11)
        assert one.kind == "room"


def test_ground_seen_from_afar_belongs_to_the_area_where_the_robot_was():
    first, second = two_areas(7.0)
    assert first.polygon[:, 0].max() == pytest.approx(4.0, abs=0.3)
    assert second.polygon[:, 0].max() == pytest.approx(4.0, abs=0.11)
    assert second.polygon[:, 0].min() == pytest.approx(0.0, abs=0.3)


def test_an_area_in_which_nothing_was_seen_has_no_extent():
    rooms = Rooms(((0,),), (), (), ())
    (one,) = extents(
        rooms, [np.zeros((1, 3))], np.zeros((1, 3)), [AREA], Places(1.7), AreaConfig()
    )  # fmt: skip
    assert one.polygon.shape == (0, 2)
    assert one.kind == "unknown"
