"""The sparse factor by fronts against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiermap_cli.estimation.fronts import Piece, factorise, plan


def problem(seed: int, groups: int, pieces: int, size: int):
    """Random groups of `size` variables, joined three at a time by pieces of full rank."""
    rng = np.random.default_rng(seed)
    members = [np.arange(size * k, size * (k + 1)) for k in range(groups)]
    made = []
    for p in range(max(pieces, groups)):
        some = {p % groups, *rng.integers(0, groups, 2).tolist()}
        index = np.sort(np.concatenate([members[k] for k in some]))
        A = rng.normal(size=(len(index) + 2, len(index)))
        made.append(Piece(index, A.T @ A, A.T @ rng.normal(size=len(A))))
    return members, made


def dense(pieces, n: int):
    H, g = np.zeros((n, n)), np.zeros(n)
    for piece in pieces:
        H[np.ix_(piece.columns, piece.columns)] += piece.H
        g[piece.columns] += piece.g
    return H, g


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 10_000), st.integers(1, 12), st.integers(1, 30), st.integers(1, 4), st.booleans()
)
def test_solution_and_marginals_are_those_of_the_dense_matrix(seed, groups, pieces, size, held):
    members, made = problem(seed, groups, pieces, size)
    n = groups * size
    H, g = dense(made, n)
    order = plan([p.columns for p in made], members, [groups - 1] if held else [])
    factor = factorise(made, order, n)
    C = np.linalg.inv(H)
    scale = np.abs(C).max()
    np.testing.assert_allclose(factor.solve(), C @ g, rtol=1e-6, atol=1e-8 * scale)
    for S, index in zip(factor.marginals(), order.columns, strict=True):
        np.testing.assert_allclose(S, C[np.ix_(index, index)], atol=1e-7 * scale)


def test_covariance_of_a_linear_function_of_far_variables():
    members, made = problem(3, 10, 14, 3)
    factor = factorise(made, plan([p.columns for p in made], members), 30)
    C = np.linalg.inv(dense(made, 30)[0])
    rng = np.random.default_rng(4)
    index = rng.permutation(30)[:9]
    J = rng.normal(size=(5, 9))
    np.testing.assert_allclose(
        factor.covariance(J, index), J @ C[np.ix_(index, index)] @ J.T, atol=1e-9
    )


def test_every_variable_is_eliminated_once_and_the_last_group_last():
    members, made = problem(5, 9, 20, 2)
    order = plan([p.columns for p in made], members, [4])
    np.testing.assert_array_equal(np.sort(np.concatenate(order.own)), np.arange(18))
    assert set(members[4]) <= set(order.own[-1])
    assert order.parent[-1] == -1
    assert all(parent > k for k, parent in enumerate(order.parent) if parent >= 0)


def test_what_is_not_determined_is_told():
    index = np.arange(3)
    H = np.diag([1.0, 1.0, 0.0])
    made = [Piece(index, H, np.zeros(3))]
    with pytest.raises(np.linalg.LinAlgError):
        factorise(made, plan([index], [index]), 3)


def test_a_chain_stays_sparse():
    """The front of a chain does not grow with its length."""
    n = 400
    pieces = [np.array([k, k + 1]) for k in range(n - 1)]
    order = plan(pieces, [np.array([k]) for k in range(n)])
    assert max(len(index) for index in order.columns) <= 3
