"""Bands of means of normalised squares, and the sentence that is made of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from hiermap_cli.evaluation.bands import (
    band,
    independent_of_chain,
    independent_of_groups,
    independent_of_sequence,
)
from hiermap_cli.evaluation.verdict import Check, innovation_checks, verdict


@pytest.mark.parametrize(("degrees", "n"), [(3, 1), (2, 5), (3, 20), (1, 400), (3, 5000)])
def test_bands_are_those_of_chi_square(degrees, n):
    k = degrees * n
    found = band(degrees, n)
    assert found.low == pytest.approx(chi2.ppf(0.025, k) / k, abs=0.02)
    assert found.high == pytest.approx(chi2.ppf(0.975, k) / k, abs=0.02)


def chain(rng, n, memory, d=3):
    x = rng.standard_normal((n, d))
    for i in range(1, n):
        x[i] = memory * x[i - 1] + np.sqrt(1 - memory**2) * x[i]
    return x


@pytest.mark.parametrize("memory", [0.0, 0.8, 0.97])
def test_independent_values_of_a_chain(memory):
    n = 20000
    truly = n * (1 - memory**2) / (1 + memory**2)
    found = independent_of_sequence(chain(np.random.default_rng(5), n, memory))
    assert found == pytest.approx(truly, rel=0.25)
    assert independent_of_chain(n, memory) == pytest.approx(truly, rel=1e-9)


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
def test_of_100_honest_runs_95_lie_in_their_band(memory):
    rng = np.random.default_rng(11)
    inside = 0
    for _ in range(200):
        x = chain(rng, 600, memory)
        found = band(3, independent_of_sequence(x))
        inside += found.low <= (x**2).mean() <= found.high
    assert 0.90 <= inside / 200 <= 0.995


def test_values_of_one_area_that_share_its_error_count_as_one():
    assert independent_of_groups([np.zeros(4), np.zeros(3)]) == pytest.approx(7.0)
    assert independent_of_groups([np.ones(4), np.ones(3)]) == pytest.approx(2.0)
    assert 2.0 < independent_of_groups([np.full(4, 0.5), np.full(3, 0.5)]) < 7.0


def test_short_sequences():
    assert independent_of_sequence(np.zeros((0, 3))) == 0.0
    assert independent_of_sequence(np.ones((1, 3))) == 1.0
    assert independent_of_sequence(np.zeros((5, 3))) == 1.0


def a_check(value, where="", name="nees_robot", n=100.0):
    return Check(name, where, value, int(n), band(3, n))


def test_the_sentence_says_by_how_much_and_where():
    said = verdict(
        [a_check(4.0), a_check(0.1, name="nees_landmarks")],
        [],
        [a_check(9.0, "area A3"), a_check(6.0, "area A2"), a_check(7.0, "kind door")],
    )
    assert said.startswith("overconfident by a factor of 2.0: ")
    assert "worst in area A3 (nees_robot 9.00) and for kind door (nees_robot 7.00)" in said


def test_too_cautious_and_consistent():
    assert verdict([a_check(0.04)], [], []).startswith("too cautious by a factor of 5.0: ")
    assert verdict([a_check(1.02)], [], []).startswith("consistent: ")
    # Right to a few percent, however many values there are.
    assert verdict([a_check(1.2, n=1e6)], [], []).startswith("consistent: ")
    assert verdict([a_check(1.3, n=1e6)], [], []).startswith("overconfident by a factor of 1.1")


def test_without_truth_the_innovations_tell_and_it_is_said():
    told = innovation_checks(
        {
            "innovations": {"matches": 900, "degrees": 1800, "nis": 2.25, "lag1": 0.1},
            "kinds": [{"kind": "door", "matches": 90, "degrees": 180, "nis": 4.0, "lag1": None}],
            "areas": [{"area": "A1", "matches": 5, "degrees": 9, "nis": None, "lag1": None}],
            "loops": [{"nis": 1.0}, {"nis": 0.5}],
        }
    )
    assert [(one.name, one.where) for one in told] == [
        ("nis", ""),
        ("nis_door", "kind door"),
        ("loop_nis", ""),
    ]
    said = verdict([], [one for one in told if not one.where], told)
    assert said.startswith("overconfident by a factor of 1.5: ")
    assert "for kind door" in said
    assert said.endswith("no truth was given, so that only the innovations tell")
    assert verdict([], innovation_checks({}), []) == ""
