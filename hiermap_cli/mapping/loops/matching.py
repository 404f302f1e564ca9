"""How does one fragment lie to another? Poses from the constellations of their walls.

Two walls of one fragment that are not parallel, taken for two of the other, give a whole pose
(design, section 8.7). All such hypotheses that the way between the fragments leaves open are
scored by the length of wall that they lay on wall; the best ones are fitted, and the figures by
which the best may be believed are those of what it leaves unexplained: whether another place does
about as well, and whether what was seen through walls.

All candidates are worked on at once: the tables below are ragged ones laid flat, a row's first
column telling the candidate that it belongs to.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.loops.correspondences import (
    Candidates,
    Correspondences,
    correspondences,
    ragged,
)
from hiermap_cli.mapping.loops.evidence import Evidence, evidence, explained, fitted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LoopConfig
    from hiermap_cli.mapping.loops.fragments import Fragments, Walls

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

PER_FRAGMENT = 10  # the longest walls of a fragment, that hypotheses are made of
PER_CANDIDATE = 40  # the longest correspondences, likewise
SCORED, FITTED = 16, 4  # hypotheses of a candidate that are scored, and of them fitted
TOGETHER = 128  # candidates worked on at once, which bounds the memory


class Matches(NamedTuple):
    """M candidates' best hypotheses, and what speaks for them and against them.

    candidate: (M,). R_i_j: (M, 3). evidence: of the best. second: (M,) the overlap of the best
    hypothesis elsewhere, over the best's. chi2: (M,) distance from the prior, 3 degrees.
    """

    candidate: Index
    R_i_j: Array
    evidence: Evidence
    second: Array
    chi2: Array

    def rows(self, which: Index | Mask) -> Matches:
        """Some of them."""
        evidence = Evidence._make(column[which] for column in self.evidence)
        return Matches(
            self.candidate[which], self.R_i_j[which], evidence, self.second[which], self.chi2[which]
        )


def match(fragments: Fragments, candidates: Candidates, config: LoopConfig) -> Matches:
    """The best hypothesis of every candidate that has one."""
    parts: list[Matches] = []
    for at in range(0, len(candidates.i), TOGETHER):
        some = candidates.rows(slice(at, at + TOGETHER))
        found = _match(fragments.walls, some, config)
        parts.append(found._replace(candidate=found.candidate + at))
    if not parts:
        return _match(fragments.walls, candidates, config)
    return Matches(
        np.concatenate([p.candidate for p in parts]),
        np.concatenate([p.R_i_j for p in parts]),
        Evidence._make(np.concatenate(c) for c in zip(*(p.evidence for p in parts), strict=True)),
        np.concatenate([p.second for p in parts]),
        np.concatenate([p.chi2 for p in parts]),
    )


def mahalanobis(candidates: Candidates, which: Index, poses: Array) -> Array:
    """Squared distances (n,) of poses (n, 3) from the priors of candidates `which` (n,)."""
    y = se2.log(se2.compose(poses, se2.invert(candidates.R_i_j[which])))
    inverse = np.linalg.inv(candidates.C_i_j)[which]
    return np.asarray(np.einsum("ni,nij,nj->n", y, inverse, y))


def _match(walls: Walls, candidates: Candidates, config: LoopConfig) -> Matches:
    pairs = correspondences(walls, candidates, config)
    whose, poses = _hypotheses(walls, candidates, pairs, config)
    score = explained(walls, pairs, len(candidates.i), whose, poses, config)
    whose, poses = _distinct(whose, poses, score, FITTED, config)
    for reach in (2.0, 1.0, 1.0):
        poses = fitted(walls, pairs, len(candidates.i), whose, poses, reach, config)
    chi2 = mahalanobis(candidates, whose, poses)
    inside = chi2 < config.gate
    whose, poses, chi2 = whose[inside], poses[inside], chi2[inside]
    score = explained(walls, pairs, len(candidates.i), whose, poses, config)
    # The best of each candidate, and the best of those elsewhere.
    order = np.lexsort((np.arange(len(score)), -score, whose))
    whose, poses, chi2, score = whose[order], poses[order], chi2[order], score[order]
    head = np.flatnonzero(np.diff(whose, prepend=-1))
    best = head[np.cumsum(np.diff(whose, prepend=-1) != 0) - 1] if len(whose) else head
    rival = np.where(_apart(poses, poses[best], config), score, 0.0)
    second = np.zeros(len(candidates.i))
    np.maximum.at(second, whose, rival)
    figures = evidence(walls, pairs, len(candidates.i), whose[head], poses[head], config)
    return Matches(
        whose[head], poses[head], figures,
        second[whose[head]] / np.maximum(score[head], 1e-9), chi2[head],
    )  # fmt: skip


def _apart(a: Array, b: Array, config: LoopConfig) -> Mask:
    """Whether poses are different places."""
    far: Mask = np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1]) > config.distinct
    far |= np.abs(se2.wrap(a[:, 2] - b[:, 2])) > config.distinct_angle
    return far


def _hypotheses(
    walls: Walls, candidates: Candidates, pairs: Correspondences, config: LoopConfig
) -> tuple[Index, Array]:
    """Poses from pairs of correspondences that are not parallel: whose (h,), and (h, 3)."""
    p, a, b = pairs
    rank_a = a - walls.start[walls.fragment[a]]
    rank_b = b - walls.start[walls.fragment[b]]
    shorter = np.minimum(walls.length[a], walls.length[b])
    long = (rank_a < PER_FRAGMENT) & (rank_b < PER_FRAGMENT)
    order = np.flatnonzero(long)
    order = order[np.lexsort((order, -shorter[order], p[order]))]
    start = np.searchsorted(p[order], np.arange(len(candidates.i) + 1))
    order = order[np.arange(len(order)) - start[p[order]] < PER_CANDIDATE]
    p, a, b, weight = p[order], a[order], b[order], shorter[order]
    end = np.searchsorted(p, p, side="right")
    first, ahead = ragged(end - np.arange(len(p)) - 1)
    second = first + 1 + ahead
    heading = se2.wrap(walls.theta[a] - walls.theta[b])
    step = se2.wrap(heading[second] - heading[first])
    n = walls.normal[a]
    cross = n[first, 0] * n[second, 1] - n[first, 1] * n[second, 0]
    ok = (np.abs(step) < config.max_angle) & (np.abs(cross) > config.least_sine)
    first, second, step, cross = first[ok], second[ok], step[ok], cross[ok]
    share = weight[second] / (weight[first] + weight[second])
    theta = se2.wrap(heading[first] + share * step)
    cos, sin = np.cos(theta), np.sin(theta)

    def rest(c: Index) -> Array:
        """How far the middle of b must move along a's normal to lie on a."""
        u = np.column_stack((walls.normal[b[c], 1], -walls.normal[b[c], 0]))
        q = u * (0.5 * (walls.lo + walls.hi))[b[c], None]
        q += walls.normal[b[c]] * walls.offset[b[c], None]
        turned = n[c, 0] * (cos * q[:, 0] - sin * q[:, 1]) + n[c, 1] * (
            sin * q[:, 0] + cos * q[:, 1]
        )
        return np.asarray(walls.offset[a[c]] - turned)

    d, e = rest(first), rest(second)
    x = (d * n[second, 1] - e * n[first, 1]) / cross
    y = (n[first, 0] * e - n[second, 0] * d) / cross
    poses, whose = np.column_stack((x, y, theta)), p[first]
    inside = mahalanobis(candidates, whose, poses) < config.gate
    return _thinned(
        whose[inside], poses[inside],
        (weight[first] + weight[second])[inside], candidates.R_i_j, config,
    )  # fmt: skip


def _thinned(
    whose: Index, poses: Array, votes: Array, prior: Array, config: LoopConfig
) -> tuple[Index, Array]:
    """One pose a cell, and of the cells those with the most votes."""
    if not len(whose):
        return whose, poses
    off = poses - prior[whose]
    off[:, 2] = se2.wrap(off[:, 2])
    size = np.array([config.max_offset, config.max_offset, config.max_angle])
    cell = np.column_stack((whose, np.floor(off / size).astype(np.int64)))
    _, at = np.unique(cell, axis=0, return_inverse=True)
    at = at.ravel()
    total = np.bincount(at, votes)
    mean = np.column_stack([np.bincount(at, votes * column) / total for column in off.T])
    owner = np.zeros(len(total), dtype=np.int64)
    owner[at] = whose
    mean += prior[owner]
    mean[:, 2] = se2.wrap(mean[:, 2])
    order = np.lexsort((np.arange(len(total)), -total, owner))
    owner, mean = owner[order], mean[order]
    start = np.searchsorted(owner, owner)
    keep = np.arange(len(owner)) - start < SCORED
    return owner[keep], mean[keep]


def _distinct(
    whose: Index, poses: Array, score: Array, count: int, config: LoopConfig
) -> tuple[Index, Array]:
    """The best hypotheses of each candidate that are apart from each other."""
    order = np.lexsort((np.arange(len(score)), -score, whose))
    whose, poses = whose[order], poses[order]
    chosen: list[Index] = []
    left = np.arange(len(whose))
    for _ in range(count):
        if not len(left):
            break
        new = np.diff(whose[left], prepend=-1) != 0
        best = left[np.flatnonzero(new)[np.cumsum(new) - 1]]
        chosen.append(left[new])
        left = left[_apart(poses[left], poses[best], config)]
    taken = np.sort(np.concatenate(chosen)) if chosen else left
    return whose[taken], poses[taken]
