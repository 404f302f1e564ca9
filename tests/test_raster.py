"""Masks of cells, held against scipy's distance transform and labels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from hiermap_cli.geometry import raster


@st.composite
def masks(draw):
    """Noise of some density, or smooth blobs with some: pieces of all sizes, holes, edges."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = draw(st.tuples(st.integers(1, 40), st.integers(1, 40)))
    values = rng.random(shape)
    if draw(st.booleans()):
        values = ndimage.uniform_filter(values, 5)
    return values < draw(st.floats(0.0, 1.0))


@given(masks(), st.sampled_from([0.5, 1.0, 1.5, 2.5, 4.0, 8.5, 13.2, 60.0]))
def test_grown_is_all_within_the_radius(mask, radius):
    expected = ndimage.distance_transform_edt(~mask) <= radius if mask.any() else mask
    assert np.array_equal(raster.grown(mask, radius), expected)
    assert np.array_equal(raster.shrunk(~mask, radius), ~expected)


@given(masks(), st.booleans())
def test_pieces_are_numbered_by_their_first_cells(mask, diagonal):
    expected, _ = ndimage.label(mask, np.ones((3, 3)) if diagonal else None)
    assert np.array_equal(raster.pieces(mask, diagonal=diagonal), expected)


def test_a_spiral_is_one_piece():
    mask = np.zeros((41, 41), dtype=bool)
    low, high = 0, 40
    while low < high:
        mask[low, max(low - 2, 0) : high + 1] = mask[low : high + 1, high] = True
        mask[high, low : high + 1] = mask[low + 2 : high + 1, low] = True
        low, high = low + 2, high - 2
    assert ndimage.label(mask)[1] == 1
    assert raster.pieces(mask).max() == 1


@given(masks())
def test_holes_are_filled(mask):
    assert np.array_equal(raster.filled(mask), ndimage.binary_fill_holes(mask))


def test_of_equal_pieces_the_first_is_the_largest():
    mask = np.zeros((3, 5), dtype=bool)
    mask[:, [0, 2, 4]] = True
    assert np.array_equal(np.flatnonzero(raster.largest(mask).any(axis=0)), [0])
    mask[1, 3] = True
    assert np.array_equal(np.flatnonzero(raster.largest(mask).any(axis=0)), [2, 3, 4])
    assert not raster.largest(np.zeros((3, 5), dtype=bool)).any()


@given(masks())
def test_depth_is_the_distance_transforms_greatest(mask):
    expected = ndimage.distance_transform_edt(np.pad(mask, 1)).max()
    assert raster.depth(mask) == pytest.approx(expected, abs=1e-9)
