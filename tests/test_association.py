"""Gates by chi-square and joint compatibility, against scipy and exhaustive search."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
import scipy.stats
from estimation_cases import random_covariance
from hypothesis import given, settings
from hypothesis import strategies as st

from hiermap_cli.estimation.association import (
    Candidates,
    chi_square,
    joint_compatibility,
    mahalanobis,
    without_the_worst,
)


@pytest.mark.parametrize("probability", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("degrees", [1, 2, 3, 12, 40])
def test_gates_are_the_chi_square_distributions(probability, degrees):
    assert chi_square(probability, degrees) == pytest.approx(
        scipy.stats.chi2.ppf(probability, degrees), rel=1e-9
    )


def test_distance_of_a_vector():
    S = random_covariance(np.random.default_rng(1), 4, 1.0)
    y = np.array([1.0, -2.0, 0.5, 3.0])
    assert mahalanobis(y, S) == pytest.approx(y @ np.linalg.inv(S) @ y)


def test_a_gate_lets_its_share_of_true_pairs_through():
    rng = np.random.default_rng(2)
    S = random_covariance(rng, 3, 0.2)
    draws = rng.multivariate_normal(np.zeros(3), S, size=4000)
    passed = np.mean([mahalanobis(y, S) <= chi_square(0.9, 3) for y in draws])
    assert passed == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / 4000))


def problem(rng, observations, most, rows, spoilt):
    """Candidates as a scan makes them: errors that all pairs share, noise of their own, and some
    pairs that are wrong by up to a few sigmas."""
    observation, cost, A = [], [], []
    shared = rng.normal(size=(rows, 2))
    innovation = []
    e = rng.normal(size=2)
    for o in range(observations):
        pairs = []
        for t in range(int(rng.integers(1, most + 1))):
            own = 0.3 + 0.3 * rng.random()
            H = shared + 0.5 * rng.normal(size=(rows, 2))
            y = H @ e + own * rng.normal(size=rows)
            if rng.random() < spoilt:
                y = y + 4.0 * rng.normal(size=rows)
            pairs.append((float(rng.random()), t, H, y, own))
        for c, _, H, y, own in sorted(pairs, key=lambda pair: pair[0]):
            observation.append(o)
            cost.append(c)
            innovation.append(y)
            A.append((H, own))
    H = np.concatenate([h for h, _ in A])
    S = H @ H.T + np.diag(np.repeat([own**2 for _, own in A], rows))
    return Candidates(np.array(observation), np.array(cost), np.array(innovation), S)


class Exhaustive:
    """All sets of pairs with at most one a observation, and which are compatible."""

    def __init__(self, candidates, probability):
        rows = candidates.innovation.shape[1]
        groups = [
            [None, *np.flatnonzero(candidates.observation == o)]
            for o in np.unique(candidates.observation)
        ]
        self.distance = {}
        for choice in product(*groups):
            chosen = tuple(i for i in choice if i is not None)
            at = [rows * i + k for i in chosen for k in range(rows)]
            y = candidates.innovation[list(chosen)].ravel()
            S = candidates.covariance[np.ix_(at, at)]
            d2 = float(y @ np.linalg.inv(S) @ y) if chosen else 0.0
            self.distance[frozenset(chosen)] = d2
        self.compatible = {
            chosen
            for chosen, d2 in self.distance.items()
            if not chosen or d2 <= scipy.stats.chi2.ppf(probability, rows * len(chosen))
        }

    def hereditary(self):
        """Compatible sets all of whose subsets are compatible: no order of search misses them."""
        return [
            chosen
            for chosen in self.compatible
            if all(
                frozenset(part) in self.compatible
                for n in range(len(chosen))
                for part in combinations(chosen, n)
            )
        ]


@settings(max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    observations=st.integers(1, 5),
    most=st.integers(1, 3),
    rows=st.integers(1, 2),
    spoilt=st.sampled_from([0.0, 0.3, 0.8]),
)
def test_against_exhaustive_search(seed, observations, most, rows, spoilt):
    candidates = problem(np.random.default_rng(seed), observations, most, rows, spoilt)
    every = Exhaustive(candidates, 0.95)
    chosen = joint_compatibility(candidates, 0.95, max_nodes=10**6)
    assert frozenset(chosen) in every.compatible
    observed = candidates.observation[chosen]
    assert len(set(observed.tolist())) == len(chosen)
    # A set may pass although a part of it does not; such a set may be missed, no other.
    largest = max(len(s) for s in every.hereditary())
    assert largest <= len(chosen) <= max(len(s) for s in every.compatible)
    best_of_each = [np.flatnonzero(candidates.observation == o)[0] for o in np.unique(observed)]
    if len(chosen) == observations and chosen == best_of_each:
        return  # taken at first sight, whole
    closest = min(
        (every.distance[s] for s in every.hereditary() if len(s) == len(chosen)), default=np.inf
    )
    assert every.distance[frozenset(chosen)] <= closest * (1 + 1e-9) + 1e-12


def test_pairs_that_pass_alone_but_contradict_each_other_do_not_pass_together():
    """Two innovations of 2 sigma in opposite directions, all of it an error that both share."""
    S = 1.0 * np.ones((2, 2)) + 0.01 * np.eye(2)
    y = np.array([[2.0], [-2.0]])
    two = Candidates(np.array([0, 1]), np.array([0.1, 0.0]), y, S)
    assert all(y[i] ** 2 / S[i, i] < chi_square(0.99, 1) for i in range(2))
    chosen = joint_compatibility(two, 0.99)
    assert len(chosen) == 1
    agreeing = two._replace(innovation=np.array([[2.0], [2.1]]))
    assert joint_compatibility(agreeing, 0.99) == [0, 1]


def test_the_second_best_is_taken_where_the_best_contradicts_the_others():
    """Four observations agree on an error of 1; the first one's cheapest pair says -1."""
    n = 5
    observation = np.array([0, 0, 1, 2, 3])
    y = np.array([[-1.0], [1.02], [0.98], [1.0], [1.01]])
    S = np.ones((n, n)) + 0.01 * np.eye(n)
    cost = np.array([0.0, 0.5, 0.1, 0.1, 0.1])
    chosen = joint_compatibility(Candidates(observation, cost, y, S), 0.99)
    assert sorted(chosen) == [1, 2, 3, 4]


def test_an_observation_that_fits_nothing_is_left_out():
    n = 4
    y = np.array([[1.0], [1.02], [6.0], [0.98]])
    S = np.ones((n, n)) + 0.01 * np.eye(n)
    four = Candidates(np.arange(n), np.zeros(n), y, S)
    assert sorted(joint_compatibility(four, 0.99)) == [0, 1, 3]


def test_nothing_where_nothing_fits_and_where_there_is_nothing():
    none = np.zeros(0, dtype=np.int64)
    empty = Candidates(none, np.zeros(0), np.zeros((0, 2)), np.zeros((0, 0)))
    assert joint_compatibility(empty, 0.99) == []
    far = Candidates(
        np.zeros(1, dtype=np.int64), np.zeros(1),
        np.array([[9.0, 9.0]]), np.eye(2),
    )  # fmt: skip
    assert joint_compatibility(far, 0.99) == []


def test_the_search_ends_where_it_may_look_no_further():
    """30 observations of 3 pairs each that all contradict each other: 4^30 sets. Within the
    nodes allowed the answer is still one that holds."""
    rng = np.random.default_rng(9)
    n = 90
    y = 3.0 * rng.normal(size=(n, 1))
    S = 9.0 * np.ones((n, n)) + 0.01 * np.eye(n)
    many = Candidates(np.repeat(np.arange(30), 3), rng.random(n), y, S)
    sizes = []
    for nodes in (100, 400, 2000):
        chosen = joint_compatibility(many, 0.99, max_nodes=nodes)
        d2 = mahalanobis(y[chosen].ravel(), S[np.ix_(chosen, chosen)])
        assert d2 <= chi_square(0.99, len(chosen))
        assert len(set(many.observation[chosen].tolist())) == len(chosen)
        sizes.append(len(chosen))
    assert sizes == sorted(sizes)
    assert sizes[0] >= 2


def test_without_nodes_only_the_first_sight_is_left():
    y = np.array([[1.0], [1.0]])
    fits = Candidates(np.arange(2), np.zeros(2), y, np.ones((2, 2)) + np.eye(2))
    assert joint_compatibility(fits, 0.99, max_nodes=0) == [0, 1]
    contradicts = fits._replace(innovation=np.array([[9.0], [-9.0]]))
    assert joint_compatibility(contradicts, 0.99, max_nodes=0) == []


@pytest.mark.parametrize("spoilt", [(), (3,), (0, 4)])
def test_the_pairs_that_spoil_a_set_are_left_out_and_no_others(spoilt):
    rng = np.random.default_rng(11)
    n = 6
    S = random_covariance(rng, 2 * n, 0.5)
    y = 0.5 * np.linalg.cholesky(S) @ rng.normal(size=2 * n)
    for i in spoilt:
        y[2 * i : 2 * i + 2] += 12.0 * np.sqrt(np.diagonal(S)[2 * i : 2 * i + 2])
    all_six = Candidates(np.arange(n), np.zeros(n), y.reshape(n, 2), S)
    kept = without_the_worst(all_six, list(range(n)), 0.999, most=2)
    if not spoilt:
        # It is asked only of sets that do not hold: one pair always goes.
        assert kept is not None
        assert len(kept) == n - 1
        return
    assert kept == [i for i in range(n) if i not in spoilt]
    at = np.ravel([[2 * i, 2 * i + 1] for i in kept])
    assert mahalanobis(y[at], S[np.ix_(at, at)]) <= chi_square(0.999, len(at))


def test_where_too_many_spoil_it_the_search_is_left_to_others():
    n = 4
    y = np.array([[30.0], [-30.0], [50.0], [-50.0]])
    S = np.ones((n, n)) + 0.01 * np.eye(n)
    torn = Candidates(np.arange(n), np.zeros(n), y, S)
    assert without_the_worst(torn, list(range(n)), 0.99, most=2) is None
