"""Which fragments may have seen the same: those that lie near each other, or may do so."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.loops.correspondences import Candidates, ragged
from hiermap_cli.mapping.loops.graph import position_variance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LoopConfig
    from hiermap_cli.mapping.loops.fragments import Fragments
    from hiermap_cli.mapping.loops.graph import Edges, Ways

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


class Asked(NamedTuple):
    """Pairs of N fragments that were asked for: key (n,), R_i_j (n, 3), sigma (n,) in metres."""

    key: Index
    R_i_j: Array
    sigma: Array

    def news(self, now: Candidates, config: LoopConfig) -> Candidates:
        """Those candidates that were not asked for yet, or of which more is known by now."""
        if not len(self.key):
            return now
        key, sigma = _key(now), _sigma(now)
        at = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
        off = se2.between(self.R_i_j[at], now.R_i_j)
        same = (self.key[at] == key) & (sigma > config.news * self.sigma[at])
        same &= np.hypot(off[:, 0], off[:, 1]) < (1.0 - config.news) * self.sigma[at]
        return now.rows(~same)

    def joined(self, anew: Candidates) -> Asked:
        """Both; of a pair asked for twice the later asking counts."""
        key = np.concatenate((_key(anew), self.key))
        _, first = np.unique(key, return_index=True)
        R = np.concatenate((anew.R_i_j, self.R_i_j))
        sigma = np.concatenate((_sigma(anew), self.sigma))
        return Asked(key[first], R[first], sigma[first])


def nothing_asked() -> Asked:
    """Before the first question."""
    return Asked(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0))


def among(edges: Edges, asked: Candidates, count: int) -> Mask:
    """Which edges join fragments, of `count`, that are asked for."""
    return np.isin(edges.i * count + edges.j, asked.i * count + asked.j)


def _key(pairs: Candidates) -> Index:
    return pairs.i << 32 | pairs.j


def _sigma(pairs: Candidates) -> Array:
    return np.sqrt(position_variance(pairs.C_i_j, pairs.R_i_j))


def candidates(
    fragments: Fragments, ways: Ways, known: Edges, broken: Mask, config: LoopConfig
) -> Candidates:
    """Pairs of fragments to be matched, the earlier one first; known ones are left out.

    Each fragment is matched with no more than `partners` earlier ones, the nearest. One that
    follows closely is matched only over a broken step, `broken` (F - 1,).
    """
    frames = ways.frames
    n = len(frames)
    i, j = near_pairs(frames[:, :2], config.near_distance + config.max_shift)
    breaks = np.concatenate(([0], np.cumsum(broken)))
    keep = (j - i > config.least_steps) | (breaks[j] > breaks[i])
    keep &= ~np.isin(i * n + j, known.i * n + known.j)
    many = np.diff(fragments.walls.start)
    keep &= (many[i] >= 2) & (many[j] >= 2)
    i, j = i[keep], j[keep]
    R, C = se2.between(frames[i], frames[j]), ways.relative(i, j)
    sigma = np.sqrt(position_variance(C, R))
    distance = np.hypot(R[:, 0], R[:, 1])
    reach = np.minimum(config.window_sigmas * sigma, config.max_shift)
    near = np.flatnonzero(distance < config.near_distance + reach)
    order = near[np.lexsort((near, distance[near], j[near]))]
    first = np.searchsorted(j[order], j[order])
    chosen = np.sort(order[np.arange(len(order)) - first < config.partners])
    return Candidates(i[chosen], j[chosen], R[chosen], C[chosen])


def near_pairs(points: Array, radius: float) -> tuple[Index, Index]:
    """All pairs i < j of points (n, 2) nearer than the radius, by cells of that size."""
    n = len(points)
    cell = np.floor(points / radius).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    width = int(cell[:, 1].max()) + 2
    key = cell[:, 0] * width + cell[:, 1]
    order = np.argsort(key, kind="stable")
    left, right = [], []
    for shift in (-width - 1, -width, -width + 1, -1, 0, 1, width - 1, width, width + 1):
        begin = np.searchsorted(key[order], key + shift)
        end = np.searchsorted(key[order], key + shift, side="right")
        i, at = ragged(end - begin)
        j = order[begin[i] + at]
        keep = (i < j) & (np.hypot(*(points[i] - points[j]).T) < radius)
        left.append(i[keep])
        right.append(j[keep])
    i, j = np.concatenate(left), np.concatenate(right)
    order = np.argsort(i * n + j, kind="stable")
    return i[order], j[order]
