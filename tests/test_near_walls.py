"""Distances to walls up to a reach, against the unbounded transform and against all pairs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from hiermap_cli.evaluation.near_walls import distance_to, nearest_to


def walls(share: float, size=(23, 41), seed: int = 4):
    return np.argwhere(np.random.default_rng(seed).random(size) < share)


@pytest.mark.parametrize("share", [0.005, 0.02, 0.3])
@pytest.mark.parametrize("reach", [0.3, 1.0, 3.0])
def test_distances_are_those_of_the_unbounded_transform(share, reach):
    at, size, cell = walls(share), (23, 41), 0.1
    empty = np.ones(size, dtype=bool)
    empty[at[:, 0], at[:, 1]] = False
    true = distance_transform_edt(empty) * cell
    expected = np.where(true <= reach + 1e-9, true, np.inf)
    assert distance_to(at, size, cell, reach) == pytest.approx(expected)


def test_without_walls_everything_is_far():
    none = np.zeros((0, 2), dtype=np.int64)
    assert np.isinf(distance_to(none, (5, 7), 0.1, 1.0)).all()
    assert (nearest_to(none, (5, 7), 3) == -1).all()


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_the_nearest_is_the_first_of_those_that_are_as_near(share):
    at, size, reach = walls(share), (23, 41), 5
    at = np.concatenate((at, at[:3]))  # a cell that is given twice counts by its first place
    cells = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1)
    squares = ((cells[:, :, None, :] - at) ** 2).sum(axis=-1)
    expected = np.where(squares.min(axis=-1) <= reach**2, squares.argmin(axis=-1), -1)
    assert np.array_equal(nearest_to(at, size, reach), expected)
