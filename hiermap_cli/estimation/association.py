"""Which observation belongs to which object: chi-square gates and joint compatibility.

Individual pairs are gated first; then a set of pairs is accepted only if its innovations agree
*together* (Neira and Tardos 2001): pairs that each pass alone, by errors of the robot that
contradict each other, do not pass as a set.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


@lru_cache(maxsize=1024)
def chi_square(probability: float, degrees: int) -> float:
    """Quantile of the chi-square distribution, by Newton's method on its closed form.

    Written here because loading scipy's takes as long as filtering a hundred scans.
    """
    x = float(degrees)
    for _ in range(200):
        # In the logarithm of the tail, which is nearly straight, and never below zero.
        tail = chi_square_tail(x, degrees)
        log_density = (
            (0.5 * degrees - 1.0) * math.log(x)
            - 0.5 * x
            - 0.5 * degrees * math.log(2.0)
            - math.lgamma(0.5 * degrees)
        )
        step = tail * math.log(tail / (1.0 - probability)) / math.exp(log_density)
        x = max(x + step, 0.1 * x)
        if abs(step) < 1e-12 * x:
            break
    return x


def chi_square_tail(x: float, degrees: int) -> float:
    """The probability that a chi-square variable of so many degrees exceeds x (finite sums)."""
    h = 0.5 * x
    odd = degrees % 2
    total = math.erfc(math.sqrt(h)) if odd else 0.0
    for i in range(degrees // 2):
        k = i + 0.5 * odd
        total += math.exp(k * math.log(h) - h - math.lgamma(k + 1.0))
    return total


class Candidates(NamedTuple):
    """Pairs that passed their own gates, sorted by observation, best first.

    observation: (c,). cost: (c,) what ranks them, lower is better.
    innovation: (c, r) rows of each pair; covariance of all pairs' rows: (c r, c r).
    """

    observation: Index
    cost: Array
    innovation: Array
    covariance: Array


def mahalanobis(innovation: Array, S: Array) -> float:
    """Squared Mahalanobis distance of a vector."""
    return float(innovation @ np.linalg.solve(S, innovation))


def joint_compatibility(
    candidates: Candidates, probability: float, max_nodes: int = 400
) -> list[int]:
    """The largest jointly compatible set of pairs, at most one a observation.

    Of equals the closest one. Returns indices into `candidates`.

    The best candidate of every observation is tried first, whole: that is nearly always it.
    Otherwise a depth-first search with at most `max_nodes` tests.
    """
    rows = candidates.innovation.shape[1]
    groups: list[list[int]] = []
    for i, o in enumerate(candidates.observation):
        if groups and candidates.observation[groups[-1][0]] == o:
            groups[-1].append(i)
        else:
            groups.append([i])
    greedy = [g[0] for g in groups]
    if not greedy or _distance(candidates, greedy) <= chi_square(probability, rows * len(greedy)):
        return greedy
    return _branch_and_bound(candidates, groups, probability, max_nodes)


def without_the_worst(
    candidates: Candidates, chosen: list[int], probability: float, most: int
) -> list[int] | None:
    """The chosen pairs less the few that spoil their joint compatibility; None if too many do.

    With `w = S^-1 y`, leaving out the rows b takes `w_b^T (S^-1)_bb^-1 w_b` off the distance: all
    single pairs are tried at the cost of one inverse.
    """
    rows = candidates.innovation.shape[1]
    for _ in range(most):
        at = (np.asarray(chosen)[:, None] * rows + np.arange(rows)).ravel()
        S_inverse = np.linalg.inv(candidates.covariance[np.ix_(at, at)])
        y = candidates.innovation[chosen].ravel()
        w = S_inverse @ y
        n = len(chosen)
        blocks = S_inverse.reshape(n, rows, n, rows)[np.arange(n), :, np.arange(n), :]
        w_b = w.reshape(n, rows)
        relief = (w_b * np.linalg.solve(blocks, w_b[..., None])[..., 0]).sum(axis=1)
        worst = int(np.argmax(relief))
        chosen = chosen[:worst] + chosen[worst + 1 :]
        if not chosen:
            return None
        if float(y @ w) - float(relief[worst]) <= chi_square(probability, rows * len(chosen)):
            return chosen
    return None


def _distance(candidates: Candidates, chosen: Sequence[int]) -> float:
    rows = candidates.innovation.shape[1]
    at = (np.asarray(chosen)[:, None] * rows + np.arange(rows)).ravel()
    return mahalanobis(candidates.innovation[chosen].ravel(), candidates.covariance[np.ix_(at, at)])


def _branch_and_bound(
    candidates: Candidates, groups: list[list[int]], probability: float, max_nodes: int
) -> list[int]:
    rows = candidates.innovation.shape[1]
    best: list[int] = []
    best_distance = np.inf
    nodes = 0
    # Groups with the clearest best candidate first: the search finds a large set early.
    order = sorted(groups, key=lambda g: float(candidates.cost[g[0]]))
    stack: list[tuple[int, list[int], float]] = [(0, [], 0.0)]
    while stack and nodes < max_nodes:
        depth, chosen, distance = stack.pop()
        if len(chosen) + len(order) - depth < len(best):
            continue
        if depth == len(order):
            if len(chosen) > len(best) or (len(chosen) == len(best) and distance < best_distance):
                best, best_distance = chosen, distance
            continue
        stack.append((depth + 1, chosen, distance))
        for i in reversed(order[depth]):
            nodes += 1
            extended = [*chosen, i]
            d2 = _distance(candidates, extended)
            if d2 <= chi_square(probability, rows * len(extended)):
                stack.append((depth + 1, extended, d2))
    return best
