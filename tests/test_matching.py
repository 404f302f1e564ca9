from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from hiermap_cli.evaluation.matching import assigned, match_points


@given(st.integers(1, 7), st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_assignments_cost_as_little_as_scipys(n, m, seed):
    cost = np.random.default_rng(seed).uniform(-1.0, 3.0, (n, m))
    pairs = assigned(cost)
    rows, columns = linear_sum_assignment(cost)
    assert len(pairs) == min(n, m)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == min(n, m)
    assert sum(cost[i, j] for i, j in pairs) == pytest.approx(cost[rows, columns].sum())


@given(st.integers(0, 12), st.integers(0, 12), st.integers(0, 2**32 - 1))
def test_as_many_as_possible_then_least_distance(n, m, seed):
    rng = np.random.default_rng(seed)
    found, true = rng.uniform(0.0, 3.0, (n, 2)), rng.uniform(0.0, 3.0, (m, 2))
    pairs = match_points(found, true, 0.8)
    if n == 0 or m == 0:
        assert len(pairs) == 0
        return
    distance = np.hypot(*np.moveaxis(found[:, None] - true[None], -1, 0))
    cost = np.where(distance <= 0.8, distance, 1000.0)
    rows, columns = linear_sum_assignment(cost)
    best = cost[rows, columns]
    assert len(pairs) == (best < 1000.0).sum()
    assert distance[pairs[:, 0], pairs[:, 1]].sum() == pytest.approx(best[best < 1000.0].sum())


def test_what_is_not_allowed_is_no_pair_however_near():
    found = np.array([[0.0, 0.0], [0.1, 0.0]])
    true = np.array([[0.0, 0.0], [0.3, 0.0]])
    assert match_points(found, true, 0.5).tolist() == [[0, 0], [1, 1]]
    allowed = np.array([[False, True], [True, False]])
    assert match_points(found, true, 0.5, allowed).tolist() == [[0, 1], [1, 0]]
    allowed[1] = False
    assert match_points(found, true, 0.5, allowed).tolist() == [[0, 1]]
