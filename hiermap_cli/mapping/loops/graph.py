"""The fragments' frames as a sparse graph: how sure their relations are, and where they lie.

Everything here is in the invariant error of the global frame, `X = exp(delta) X_hat`: the
covariance of a way is then the sum of those of its steps, wherever it leads.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.fronts import Piece, factorise, plan
from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

LEVER = 10.0  # metres by which an error of heading is compared with one of position
ITERATIONS = 12
CONVERGED = 1e-3  # metres and radians


class Edges(NamedTuple):
    """E relations of fragments: i, j (E,), R_i_j (E, 3), C_i_j (E, 3, 3).

    C_i_j is the covariance of `log(R_i_j R_i_j_hat^-1)`, which is in the frame of i.
    """

    i: Index
    j: Index
    R_i_j: Array
    C_i_j: Array

    def rows(self, which: Index | Mask) -> Edges:
        """Some of them."""
        return Edges._make(column[which] for column in self)


def joined(parts: Sequence[Edges]) -> Edges:
    """Relations of several kinds in one table."""
    return Edges._make(np.concatenate(column) for column in zip(*parts, strict=True))


def no_edges() -> Edges:
    """An empty table."""
    none = np.zeros(0, dtype=np.int64)
    return Edges(none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)))


def moved(C: Array, X: Array) -> Array:
    """Covariances (..., 3, 3) of errors from the left, seen from a frame that sees this as X."""
    Ad = se2.adjoint(X)
    return np.asarray(Ad @ C @ np.swapaxes(Ad, -1, -2))


def discrepancy(frames: Array, edges: Edges) -> Array:
    """What edges ask of the frames (F, 3): `delta_j - delta_i` of each, in g, (E, 3)."""
    asked = se2.compose(frames[edges.i], edges.R_i_j)
    return se2.log(se2.compose(asked, se2.invert(frames[edges.j])))


def chi2(frames: Array, edges: Edges) -> Array:
    """Squared distances (E,) of the frames' relations from those of the edges."""
    R = se2.between(frames[edges.i], frames[edges.j])
    r = se2.log(se2.compose(R, se2.invert(edges.R_i_j)))
    return np.asarray(np.einsum("ni,nij,nj->n", r, np.linalg.inv(edges.C_i_j), r))


class Ways(NamedTuple):
    """How well any two of F fragments know of each other, by the best of a few ways.

    Trees of shortest ways, the first one being the path itself. covariance: (T, F, 3, 3) of the
    way from the root, in g. up: (T, L, F) the ancestor 2^l steps above. depth: (T, F).
    """

    frames: Array
    covariance: Array
    up: Index
    depth: Index

    def relative(self, i: Index, j: Index) -> Array:
        """Covariances (n, 3, 3) of relations R_i_j, in the frame of i: the least of the ways.

        An upper bound: a relation over several ways is known better than over the best.
        """
        best = np.zeros((len(i), 3, 3))
        least = np.full(len(i), np.inf)
        R = se2.between(self.frames[i], self.frames[j])
        back = se2.invert(self.frames[i])
        for t in range(len(self.up)):
            common = self._common(t, i, j)
            S = self.covariance[t]
            C = moved(S[i] + S[j] - 2.0 * S[common], back)
            size = position_variance(C, R) + LEVER**2 * C[:, 2, 2]
            better = size < least
            best[better], least[better] = C[better], size[better]
        return best

    def chi2(self, edges: Edges) -> Array:
        """Squared distances (E,) of edges from the relations as the ways have them."""
        R = se2.between(self.frames[edges.i], self.frames[edges.j])
        r = se2.log(se2.compose(edges.R_i_j, se2.invert(R)))
        C = self.relative(edges.i, edges.j) + edges.C_i_j
        return np.asarray(np.einsum("ni,nij,nj->n", r, np.linalg.inv(C), r))

    def _common(self, t: int, i: Index, j: Index) -> Index:
        """The lowest common ancestors in tree t."""
        up, depth = self.up[t], self.depth[t]
        low = np.where(depth[i] < depth[j], j, i)
        high = np.where(depth[i] < depth[j], i, j)
        for level in range(len(up) - 1, -1, -1):
            step = depth[low] - depth[high] >= 1 << level
            low = np.where(step, up[level][low], low)
        for level in range(len(up) - 1, -1, -1):
            apart = up[level][low] != up[level][high]
            low, high = (
                np.where(apart, up[level][low], low),
                np.where(apart, up[level][high], high),
            )
        return np.where(low == high, low, up[0][low])


def position_variance(C: Array, R: Array) -> Array:
    """Of where the origins of poses R (n, 3) lie, by their invariant covariances: (n,)."""
    x, y = R[:, 0], R[:, 1]
    return np.asarray(
        C[:, 0, 0] + C[:, 1, 1] + 2.0 * (x * C[:, 1, 2] - y * C[:, 0, 2])
        + (x * x + y * y) * C[:, 2, 2]
    )  # fmt: skip


def ways(frames: Array, edges: Edges) -> Ways:
    """The ways over edges between F fragments; the first F - 1 edges are the path's steps.

    Besides the path, the shortest ways from its beginning, middle and end.
    """
    n = len(frames)
    C = moved(edges.C_i_j, frames[edges.i])
    size = np.trace(edges.C_i_j[:, :2, :2], axis1=1, axis2=2) + LEVER**2 * edges.C_i_j[:, 2, 2]
    path = np.arange(n)
    trees = [(path, np.maximum(path - 1, 0), np.maximum(path - 1, 0))]
    if len(edges.i) > n - 1:
        trees += [_shortest(n, edges, size, root) for root in sorted({0, n // 2, n - 1})]
    total, depth = np.zeros((len(trees), n, 3, 3)), np.zeros((len(trees), n), dtype=np.int64)
    for t, (order, parent, edge) in enumerate(trees):
        for k in order[1:].tolist():
            total[t, k] = total[t, parent[k]] + C[edge[k]]
            depth[t, k] = depth[t, parent[k]] + 1
    levels = max(1, int(depth.max(initial=0)).bit_length())
    up = np.empty((len(trees), levels, n), dtype=np.int64)
    for t, (_, parent, _) in enumerate(trees):
        up[t, 0] = parent
        for level in range(1, levels):
            up[t, level] = up[t, level - 1][up[t, level - 1]]
    return Ways(frames, total, up, depth)


def _shortest(n: int, edges: Edges, size: Array, root: int) -> tuple[Index, Index, Index]:
    """Dijkstra's tree: the fragments in the order of reach, their parents, and the edges there."""
    next_to: list[list[tuple[float, int, int]]] = [[] for _ in range(n)]
    for e, (i, j, s) in enumerate(
        zip(edges.i.tolist(), edges.j.tolist(), size.tolist(), strict=True)
    ):
        next_to[i].append((s, j, e))
        next_to[j].append((s, i, e))
    parent, by = np.full(n, root), np.zeros(n, dtype=np.int64)
    order: list[int] = []
    reached = [False] * n
    waiting = [(0.0, root, root, 0)]
    while waiting:
        cost, k, above, e = heapq.heappop(waiting)
        if reached[k]:
            continue
        reached[k] = True
        order.append(k)
        parent[k], by[k] = above, e
        for s, other, edge in next_to[k]:
            if not reached[other]:
                heapq.heappush(waiting, (cost + s, other, k, edge))
    return np.array(order), parent, by


def solved(frames: Array, edges: Edges, robust: Mask, scale: float) -> Array:
    """The frames (F, 3) that all edges agree on best; the first one stays.

    Gauss-Newton with a sparse factorisation. Edges marked `robust` have Cauchy's loss of the
    given scale: one that is alone against many does not bend them.
    """
    n = len(frames)
    if n < 2:
        return frames
    low, high = np.minimum(edges.i, edges.j), np.maximum(edges.i, edges.j)
    swap = (edges.i > edges.j)[:, None, None]
    both = np.concatenate(
        (3 * low[:, None] + np.arange(3), 3 * high[:, None] + np.arange(3)), axis=1
    )
    first = Piece(np.arange(3), 1e12 * np.eye(3), np.zeros(3))
    order = plan([*both, first.columns], list(np.arange(3 * n).reshape(n, 3)))
    W = np.linalg.inv(edges.C_i_j)
    for _ in range(ITERATIONS):
        R = se2.between(frames[edges.i], frames[edges.j])
        r = se2.log(se2.compose(R, se2.invert(edges.R_i_j)))
        distance = np.einsum("ni,nij,nj->n", r, W, r)
        weight = np.where(robust, 1.0 / (1.0 + distance / scale**2), 1.0)
        Ad = se2.adjoint(se2.invert(frames[edges.i]))
        J = np.where(swap, np.concatenate((Ad, -Ad), axis=2), np.concatenate((-Ad, Ad), axis=2))
        WJ = weight[:, None, None] * (W @ J)
        H, g = J.transpose(0, 2, 1) @ WJ, -np.einsum("nij,ni->nj", WJ, r)
        pieces = [Piece(*piece) for piece in zip(both, H, g, strict=True)]
        delta = factorise([*pieces, first], order, 3 * n).solve().reshape(n, 3)
        frames = se2.compose(se2.exp(delta), frames)
        shift = delta[:, :2] + delta[:, 2:] * np.column_stack((-frames[:, 1], frames[:, 0]))
        if np.abs(shift).max() < CONVERGED and np.abs(delta[:, 2]).max() < CONVERGED:
            break
    return frames
