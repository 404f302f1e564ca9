"""The median is numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiermap_cli.geometry.median import median


@pytest.mark.parametrize("shape", [(1,), (2,), (5, 2), (6, 3), (101,), (100, 1)])
def test_it_is_numpys(shape):
    values = np.random.default_rng(1).normal(size=shape)
    before = values.copy()
    assert np.array_equal(median(values), np.median(values, axis=0))
    assert np.array_equal(values, before)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=9))
def test_half_of_the_values_lie_on_either_side(values):
    middle = float(median(np.array(values)))
    assert 2 * sum(value <= middle for value in values) >= len(values)
    assert 2 * sum(value >= middle for value in values) >= len(values)
