"""Sparse Cholesky by fronts: normal equations eliminated group by group, each a dense matrix.

The variables of a building hang together as its rooms do: eliminating the poses of a stretch of
the path leaves a dense matrix over the few landmarks seen there, a *piece*; eliminating a group
of landmarks joins the pieces that hold any of it. This is the multifrontal method (Duff and Reid
1983) with groups that are known beforehand. Its cost grows with the building, not with its
square, and the same factor gives every marginal covariance.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


ALIKE = 0.15  # of a front's size, by which it may grow so that one more group goes with it


class Piece(NamedTuple):
    """A term of the normal equations `H x = g` over the variables `columns` (n,), sorted."""

    columns: Index
    H: Array
    g: Array


class Front(NamedTuple):
    """An eliminated group.

    own: (n,) its variables. boundary: (m,) those that remain of the pieces joined, sorted. With
    the Cholesky factor L of the own block: L_inverse (n, n), W = L^-1 F_ob (n, m), y = L^-1 g_o.
    """

    own: Index
    boundary: Index
    L_inverse: Array
    W: Array
    y: Array


class Plan(NamedTuple):
    """In which order groups are eliminated, and what is joined there.

    own: the variables of each front. columns: own and boundary, sorted. pieces: the numbers of the
    pieces joined; piece `first + k` is what front k leaves. parent: the front that takes it in,
    -1 for the last.
    """

    own: tuple[Index, ...]
    columns: tuple[Index, ...]
    pieces: tuple[tuple[int, ...], ...]
    parent: tuple[int, ...]


def plan(pieces: Sequence[Index], groups: Sequence[Index], last: Sequence[int] = ()) -> Plan:
    """A good order of elimination: always the group with the smallest front (minimum degree).

    Groups whose own front holds hardly more are eliminated with it.

    Args:
        pieces: the variables of each piece, sorted.
        groups: variables that are eliminated together; each in one group only.
        last: groups to be eliminated after all others, in this order.
    """
    graph = _Graph(pieces, groups)
    final = set(last)
    waiting = [(graph.degree(k), k) for k in range(len(groups)) if k not in final]
    heapq.heapify(waiting)
    while waiting:
        d, k = heapq.heappop(waiting)
        if k in graph.done:
            continue
        now = graph.degree(k)
        if now > d and waiting and now > waiting[0][0]:
            heapq.heappush(waiting, (now, k))
            continue
        graph.take(k, final)
    for k in last:
        graph.take(k, final)
    return graph.finished()


class _Graph:
    """Groups and the pieces that hold them, while groups are eliminated."""

    def __init__(self, pieces: Sequence[Index], groups: Sequence[Index]) -> None:
        group_of = np.empty(1 + max(int(g.max()) for g in groups), dtype=np.int64)
        for k, g in enumerate(groups):
            group_of[g] = k
        self.groups = groups
        self.done: set[int] = set()
        self._size = [len(g) for g in groups]
        self._inside = [set(np.unique(group_of[index]).tolist()) for index in pieces]
        self._holding: list[set[int]] = [set() for _ in groups]
        for p, members in enumerate(self._inside):
            for k in members:
                self._holding[k].add(p)
        self._own: list[Index] = []
        self._index: list[Index] = []
        self._joined: list[tuple[int, ...]] = []
        self._maker: dict[int, int] = {}

    def degree(self, k: int) -> int:
        """The size of a group's front."""
        return sum(self._size[j] for j in self._front(k))

    def take(self, k: int, final: set[int]) -> None:
        """Eliminate a group, with those that cost hardly more together than apart."""
        members = self._front(k) | {k}
        size = sum(self._size[j] for j in members)
        own, used = [k], set(self._holding[k])
        for j in sorted(members - {k} - final):
            more = self._front(j) - members
            if sum(self._size[i] for i in more) <= ALIKE * size:
                own.append(j)
                used |= self._holding[j]
                members |= more
        new = len(self._inside)
        self._maker[new] = len(self._own)
        self._own.append(np.sort(np.concatenate([self.groups[j] for j in own])))
        self._index.append(np.sort(np.concatenate([self.groups[j] for j in members])))
        self._joined.append(tuple(sorted(used)))
        self.done |= set(own)
        rest = members - set(own)
        self._inside.append(rest)
        for p in used:
            for j in self._inside[p] & rest:
                self._holding[j].discard(p)
        for j in rest:
            self._holding[j].add(new)

    def finished(self) -> Plan:
        """The plan, when all groups are eliminated."""
        parent = [-1] * len(self._own)
        for f, numbers in enumerate(self._joined):
            for p in numbers:
                if p in self._maker:
                    parent[self._maker[p]] = f
        return Plan(tuple(self._own), tuple(self._index), tuple(self._joined), tuple(parent))

    def _front(self, k: int) -> set[int]:
        return set().union(*(self._inside[p] for p in self._holding[k]))


class Factor(NamedTuple):
    """All fronts in the order of elimination, the plan that made them, and each variable's front.

    home: (N,) of all N variables.
    """

    fronts: tuple[Front, ...]
    plan: Plan
    home: Index

    def solve(self) -> Array:
        """X of `H x = g`, by back substitution."""
        x = np.zeros(len(self.home))
        for front in reversed(self.fronts):
            x[front.own] = front.L_inverse.T @ (front.y - front.W @ x[front.boundary])
        return x

    def marginals(self) -> list[Array]:
        """The joint covariance of each front's variables, (n, n) in the order of `plan.columns`.

        Given that of its boundary, which is part of its parent's: Takahashi's recursion, by
        blocks.
        """
        found: list[Array] = [np.zeros((0, 0))] * len(self.fronts)
        for k in range(len(self.fronts) - 1, -1, -1):
            front, index = self.fronts[k], self.plan.columns[k]
            at_own, at_boundary = np.searchsorted(index, front.own), None
            G = front.L_inverse.T @ front.W
            S = np.empty((len(index), len(index)))
            if len(front.boundary):
                parent = self.plan.parent[k]
                inside = np.searchsorted(self.plan.columns[parent], front.boundary)
                P = found[parent][np.ix_(inside, inside)]
                at_boundary = np.searchsorted(index, front.boundary)
                GP = G @ P
                S[np.ix_(at_boundary, at_boundary)] = P
                S[np.ix_(at_own, at_boundary)] = -GP
                S[np.ix_(at_boundary, at_own)] = -GP.T
                S[np.ix_(at_own, at_own)] = front.L_inverse.T @ front.L_inverse + GP @ G.T
            else:
                S[np.ix_(at_own, at_own)] = front.L_inverse.T @ front.L_inverse
            found[k] = S
        return found

    def covariance(self, J: Array, index: Index) -> Array:
        """`J C J^T` of a linear function J (r, n) of the variables `index` (n,).

        Low in the tree of fronts only few of the r rows have a part: only they are carried on.
        """
        index, J = _once(index, J)
        columns: dict[int, Array] = {}

        def add(where: Index, rows: Array, part: Index | slice = slice(None)) -> None:
            fronts = self.home[where]
            for k in np.unique(fronts).tolist():
                here = fronts == k
                own = self.fronts[k].own
                if k not in columns:
                    columns[k] = np.zeros((len(own), len(J)))
                at = np.searchsorted(own, where[here])
                if isinstance(part, slice):
                    columns[k][at] += rows[here]
                else:
                    columns[k][at[:, None], part] += rows[here]

        add(index, J.T)
        C = np.zeros((len(J), len(J)))
        waiting = list(columns)
        heapq.heapify(waiting)
        seen: set[int] = set()
        while waiting:
            k = heapq.heappop(waiting)
            if k in seen:
                continue
            seen.add(k)
            front = self.fronts[k]
            told = columns.pop(k)
            some = np.flatnonzero((told != 0.0).any(axis=0))
            few = 2 * len(some) < len(J)
            y = front.L_inverse @ (told[:, some] if few else told)
            if few:
                C[some[:, None], some] += y.T @ y
            else:
                C += y.T @ y
            if len(front.boundary):
                before = set(columns)
                add(front.boundary, -front.W.T @ y, some if few else slice(None))
                for j in set(columns) - before:
                    heapq.heappush(waiting, j)
        return C


def _once(index: Index, J: Array) -> tuple[Index, Array]:
    """The variables in order, each once, and J (r, n) by them."""
    order = np.argsort(index, kind="stable")
    first = np.flatnonzero(np.diff(index[order], prepend=-1))
    if not len(first):
        return index, J
    return index[order[first]], np.add.reduceat(J[:, order], first, axis=1)


def factorise(pieces: Sequence[Piece], order: Plan, variables: int) -> Factor:
    """Eliminates all groups of a plan that was made for pieces with these variables.

    Raises:
        numpy.linalg.LinAlgError: the problem does not determine all variables.
    """
    waiting: dict[int, Piece] = dict(enumerate(pieces))
    made = len(pieces)
    fronts = []
    for own, index, numbers in zip(order.own, order.columns, order.pieces, strict=True):
        n = len(index)
        F, g = np.zeros((n, n)), np.zeros(n)
        for p in numbers:
            piece = waiting.pop(p)
            at = np.searchsorted(index, piece.columns)
            F[at[:, None], at] += piece.H
            g[at] += piece.g
        at_own = np.searchsorted(index, own)
        rest = np.ones(n, dtype=bool)
        rest[at_own] = False
        at_boundary = np.flatnonzero(rest)
        L_inverse = np.linalg.inv(np.linalg.cholesky(F[at_own[:, None], at_own]))
        W = L_inverse @ F[at_own[:, None], at_boundary]
        y = L_inverse @ g[at_own]
        boundary = index[at_boundary]
        fronts.append(Front(own, boundary, L_inverse, W, y))
        waiting[made] = Piece(
            boundary, F[at_boundary[:, None], at_boundary] - W.T @ W, g[at_boundary] - W.T @ y
        )
        made += 1
    home = np.empty(variables, dtype=np.int64)
    for k, front in enumerate(fronts):
        home[front.own] = k
    return Factor(tuple(fronts), order, home)
