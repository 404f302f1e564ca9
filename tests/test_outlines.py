"""Outlines of regions: one simple polygon each, whatever holes the region has."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from hiermap_cli.geometry import raster
from hiermap_cli.mapping.areas.outlines import outline, simplified, slit
from hiermap_cli.mapping.topology.freespace import CELL, Region, closed


def polygon_of(mask, detail=0.1):
    ring = outline(Region(np.asarray(mask, dtype=bool), (0, 0)), detail)
    return shapely.Polygon(ring)


def ring_corridor(turn=0.0, w=200, h=150):
    """A corridor of 2 m about a block of 12 m x 7 m, turned about its middle."""
    i, j = np.indices((w, h)) + 0.5
    x, y = i - 0.5 * w, j - 0.5 * h
    c, s = np.cos(turn), np.sin(turn)
    u, v = np.abs(c * x + s * y), np.abs(c * y - s * x)
    return (u < 80) & (v < 55) & ~((u < 60) & (v < 35))


@pytest.mark.parametrize("turn", [0.0, 0.2, 0.7, 1.3])
def test_the_block_in_a_ring_of_corridors_is_left_out(turn):
    mask = ring_corridor(turn)[30:170] if turn == 0.0 else ring_corridor(turn, 260, 260)
    polygon = polygon_of(mask)
    assert polygon.is_valid
    assert polygon.exterior.is_ccw
    free = np.count_nonzero(mask) * CELL**2
    assert polygon.area == pytest.approx(free, rel=0.03)
    at = shapely.points(CELL * (np.argwhere(~mask & raster.filled(mask)) + 0.5))
    assert np.mean(shapely.contains(polygon, at)) < 0.03


def test_the_slit_is_one_cell_wide_at_the_narrowest_place():
    mask = np.zeros((40, 40), dtype=bool)
    mask[2:38, 2:38] = True
    mask[20:30, 12:28] = False  # 8 cells from the border at x = 38, more elsewhere
    opened = slit(mask)
    gone = np.argwhere(mask & ~opened)
    assert len(gone) == 8
    assert (gone[:, 1] == gone[0, 1]).all()
    assert gone[:, 0].min() == 30


def test_all_holes_are_opened_and_the_region_stays_one():
    mask = np.zeros((90, 60), dtype=bool)
    mask[2:88, 2:58] = True
    for i in (10, 36, 62):
        mask[i : i + 14, 10:20] = False
        mask[i : i + 14, 34:48] = False
    opened = slit(mask)
    assert raster.pieces(~opened).max() == 1
    assert raster.pieces(opened).max() == 1
    polygon = polygon_of(mask, 0.2)
    assert polygon.is_valid
    assert not polygon.interiors


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    share=st.floats(0.5, 0.9),
    detail=st.sampled_from([0.0, 0.05, 0.1, 0.3, 1.0]),
)
def test_any_region_has_a_simple_outline(seed, share, detail):
    rng = np.random.default_rng(seed)
    cells = rng.random((24, 20)) < share
    mask = raster.largest(np.pad(cells, 2))
    polygon = polygon_of(mask, detail)
    assert polygon.is_valid
    assert polygon.exterior.is_ccw
    if detail == 0.0:
        opened = slit(np.pad(mask, 1))
        # Corners at which two cells only touch are cut off on both sides.
        assert polygon.area == pytest.approx(np.count_nonzero(opened) * CELL**2, rel=0.05)


def test_cells_that_only_touch_do_not_make_the_outline_touch_itself():
    mask = np.array([[1, 1, 1, 1], [1, 0, 0, 1], [1, 0, 1, 0], [1, 1, 1, 1]], dtype=bool)
    assert polygon_of(mask, 0.0).is_valid


def test_a_narrow_fold_stays_open_however_coarse_the_outline_is():
    """The two sides of a slit are 0.1 m apart: chords of 0.3 m would cross."""
    x = np.arange(0.0, 4.0, 0.1)
    wave = 0.25 * np.sin(3.0 * x)
    ring = np.vstack(
        (np.column_stack((x, wave)), np.column_stack((x, wave + 0.1))[::-1], [[-1, 3], [-1, -3]])
    )
    assert shapely.Polygon(ring).is_valid
    assert shapely.Polygon(simplified(ring, 0.3)).is_valid


def test_small_holes_are_furniture_and_large_ones_are_not():
    mask = np.zeros((120, 80), dtype=bool)
    mask[2:118, 2:78] = True
    mask[10:30, 10:30] = False  # 4 square metres
    mask[50:100, 20:60] = False  # 20 of them
    mask[6:112, 66:72] = False  # 6.4 of them, but no wider than a cupboard
    region = closed(Region(mask, (0, 0)), 1.2, 5.0)
    assert region.contains(np.array([2.0, 2.0]))
    assert region.contains(np.array([6.0, 6.9]))
    assert not region.contains(np.array([7.5, 4.0]))
    assert closed(Region(mask, (0, 0)), 1.2).contains(np.array([7.5, 4.0]))


def test_what_is_anothers_is_not_closed():
    mask = np.zeros((60, 40), dtype=bool)
    mask[:, :] = True
    theirs = np.zeros_like(mask)
    theirs[20:34, 10:24] = True
    theirs[50:, :6] = True
    own = Region(mask & ~theirs, (0, 0))
    assert closed(own, 1.2, 5.0).contains(np.array([2.5, 1.5]))
    region = closed(own, 1.2, 5.0, theirs)
    assert not region.inside(CELL * (np.argwhere(theirs) + 0.5)).any()
