"""The group SE(2): its laws, its maps to and from the tangent space, and its adjoint."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hiermap_cli.geometry import se2

length = st.floats(-50.0, 50.0)
angle = st.floats(-3.14, 3.14)
poses = st.tuples(length, length, angle).map(np.array)
batches = arrays(float, (4, 3), elements=st.floats(-3.0, 3.0))


def same(a, b, tolerance=1e-9):
    """Whether two poses are the same, their headings up to a turn."""
    off = np.asarray(a) - np.asarray(b)
    off[..., 2] = se2.wrap(off[..., 2])
    return np.abs(off).max() < tolerance


@given(poses, poses, poses)
def test_the_laws_of_a_group(a, b, c):
    assert same(se2.compose(a, se2.IDENTITY), a)
    assert same(se2.compose(a, se2.invert(a)), se2.IDENTITY)
    assert same(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))
    assert same(se2.between(a, b), se2.compose(se2.invert(a), b))


@given(poses)
def test_exponential_and_logarithm_undo_each_other(a):
    assert same(se2.exp(se2.log(a)), a)
    assert same(se2.log(se2.exp(a)), a)


@given(poses, poses)
def test_the_adjoint_moves_a_tangent_to_the_other_side(a, tangent):
    right = se2.compose(a, se2.exp(tangent))
    left = se2.compose(se2.exp(se2.adjoint(a) @ tangent), a)
    assert same(right, left, 1e-6)


@given(batches, batches)
def test_poses_moved_by_tangents_are_composed_with_their_exponentials(a, tangent):
    tangent[0, 2] = 0.0
    assert same(se2.moved(a, tangent), se2.compose(se2.exp(tangent), a))


@given(poses, batches)
def test_a_pose_before_many_is_before_each(a, b):
    assert same(se2.compose(a, b), np.array([se2.compose(a, x) for x in b]))


@given(batches, batches)
def test_a_batch_is_its_single_poses(a, b):
    for many, one in (
        (se2.compose(a, b), [se2.compose(x, y) for x, y in zip(a, b, strict=True)]),
        (se2.between(a, b), [se2.between(x, y) for x, y in zip(a, b, strict=True)]),
        (se2.invert(a), [se2.invert(x) for x in a]),
        (se2.exp(a), [se2.exp(x) for x in a]),
        (se2.log(a), [se2.log(x) for x in a]),
    ):
        assert same(many, np.array(one))


@given(poses)
def test_the_two_errors_of_a_pose_are_inverse_maps(a):
    product = se2.additive_D_invariant(a) @ se2.invariant_D_additive(a)
    assert np.allclose(product, np.eye(3))


@pytest.mark.parametrize("turns", [-3, -1, 0, 1, 2])
def test_angles_are_wrapped_to_the_half_open_turn(turns):
    for inside in (np.pi, 0.0, -3.0, 1.5):
        assert se2.wrap(np.array(inside + 2 * np.pi * turns)) == pytest.approx(inside)
        assert se2.wrap_one(inside + 2 * np.pi * turns) == pytest.approx(inside)
    assert se2.wrap_one(-np.pi) == np.pi


@given(poses, poses)
def test_interpolation_begins_and_ends_at_its_poses_by_the_shorter_arc(a, b):
    way = se2.interpolate(np.array([a] * 3), np.array([b] * 3), np.array([0.0, 0.5, 1.0]))
    assert same(way[0], a)
    assert same(way[2], b)
    assert abs(se2.wrap_one(float(way[1, 2] - a[2]))) <= np.pi / 2 + 1e-9
