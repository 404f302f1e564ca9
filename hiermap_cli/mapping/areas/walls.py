"""An area's walls and ends as the lines that landmarks are made of.

A wall of the area's state is a line with an extent, and its ends are objects of their own. Where
a wall has a gap (a door in it), or was matched with another wall in the same line, its ends tell:
it runs from where it begins to where it ends, and what was seen of its line before it begins or
after it ends belongs to another wall.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2
from hiermap_cli.geometry.lines import intersect, intersect_D_lines
from hiermap_cli.mapping.area_map import END, WALL
from hiermap_cli.perception.kinds.corner import RULES as CORNERS
from hiermap_cli.perception.kinds.lineset import NO_PASSAGES, LineSet
from hiermap_cli.perception.segments import END_FREE, END_OPEN, END_VERTEX

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.estimation.stochastic_map import StochasticMap
    from hiermap_cli.mapping.area_map import Features

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

_SHORTEST = 0.1  # metres of a piece between two ends


class WallLines(NamedTuple):
    """The lines of an area, and how they depend on its state.

    lines: in the area's frame. wall: (n,) the object behind each. by_state: (4 n, N) d (alpha,
    d, s1, s2) / d error of V, line by line. covariance: (N, N) of that error.
    """

    lines: LineSet
    wall: Index
    by_state: Array
    covariance: Array


class Piece(NamedTuple):
    """A stretch of a wall, along its X axis; `ends` are objects, -1 where it is open."""

    lo: float
    hi: float
    ends: tuple[int, int]


def wall_lines(
    V: StochasticMap, features: Features, config: LandmarkConfig, passages: Array = NO_PASSAGES
) -> WallLines:
    """All pieces of an area's walls that were seen often enough.

    passages: (m, 4), see LineSet; in the area's frame.
    """
    f = features
    walls: list[int] = []
    pieces: list[Piece] = []
    for w in np.flatnonzero((f.kind == WALL) & (f.seen >= config.least_seen)).tolist():
        own = np.flatnonzero(
            (f.kind == END) & (f.wall == f.uid[w]) & (f.seen >= min(config.end_seen, f.seen[w]))
        )
        x = se2.between(V.poses[1 + w], V.poses[1 + own])[:, 0]
        for piece in wall_pieces(float(f.lo[w]), float(f.hi[w]), own, x, f.side[own], f.seen[own]):
            walls.append(w)
            pieces.append(piece)
    n = len(pieces)
    index = np.array(walls, dtype=np.int64)
    X = V.poses[1 + index]
    theta = X[:, 2]
    alpha = se2.wrap(theta - 0.5 * np.pi)
    c, s = np.cos(alpha), np.sin(alpha)
    d = c * X[:, 0] + s * X[:, 1]
    origin = c * X[:, 1] - s * X[:, 0]
    along = origin[:, None] + np.array([(p.lo, p.hi) for p in pieces]).reshape(n, 2)
    kind = np.full((n, 2), END_OPEN)
    by_state = np.zeros((n, 4, len(V.covariance)))
    for i, (w, piece) in enumerate(zip(walls, pieces, strict=True)):
        T = V.invariant_D_error(V.poses[1 + w])
        by_state[i, :2, V.columns(1 + w)] = _hesse_by_delta(float(alpha[i])) @ T
        for k, e in enumerate(piece.ends):
            if e < 0:
                continue
            kind[i, k] = END_FREE
            P = V.poses[1 + e]
            along[i, k] = c[i] * P[1] - s[i] * P[0]
            # s = t . P, and t turns with the line: ds = t . dP - d dalpha.
            moved = np.array([-s[i], c[i], s[i] * P[1] + c[i] * P[0]])
            by_state[i, 2 + k, V.columns(1 + e)] += moved @ V.invariant_D_error(P)
            by_state[i, 2 + k] -= d[i] * by_state[i, 0]
    flat = by_state.reshape(4 * n, len(V.covariance))
    lines = LineSet(
        hesse=np.column_stack((alpha, d)),
        along=along,
        kind=kind,
        seen=f.seen[index],
        covariance=symmetrise(flat @ V.covariance @ flat.T),
        passages=passages,
    )
    return WallLines(lines, index, flat, V.covariance)


def at_vertices(walls: WallLines, config: LandmarkConfig) -> WallLines:
    """The lines with their ends at the corners that they make.

    Where two walls meet, the point where their lines cross tells better where they end than the
    last beam that hit them.
    """
    lines = walls.lines
    if not len(lines):
        return walls
    along, kind, by_state = lines.along.copy(), lines.kind.copy(), walls.by_state.copy()
    for group in CORNERS.find(lines, np.zeros(len(lines), dtype=bool), config):
        both = list(group.lines)
        first, second = lines.hesse[both]
        V = intersect(first, second)
        rows = walls.by_state.reshape(len(lines), 4, -1)[both, :2].reshape(4, -1)
        V_by_state = intersect_D_lines(first, second) @ rows
        for i, side in zip(both, (1, 0), strict=True):
            alpha, d = lines.hesse[i]
            t = np.array([-np.sin(alpha), np.cos(alpha)])
            along[i, side], kind[i, side] = t @ V, END_VERTEX
            by_state[4 * i + 2 + side] = t @ V_by_state - d * walls.by_state[4 * i]
    C = symmetrise(by_state @ walls.covariance @ by_state.T)
    return walls._replace(
        lines=replace(lines, along=along, kind=kind, covariance=C), by_state=by_state
    )


def wall_pieces(
    lo: float, hi: float, ends: Index, x: Array, side: Index, seen: Index
) -> list[Piece]:
    """The stretches of a wall between where it begins (side 0) and where it ends (side 1).

    Of two that contradict each other, such as two beginnings without an end between them, the
    one that was seen more often holds.
    """
    marks = [
        (float(x[k]), int(side[k]), int(ends[k]), int(seen[k]))
        for k in np.lexsort((ends, x)).tolist()
    ]
    kept: list[tuple[float, int, int, int]] = []
    for mark in marks:
        if kept and kept[-1][1] == mark[1]:
            if mark[3] > kept[-1][3]:
                kept[-1] = mark
        else:
            kept.append(mark)
    pieces: list[Piece] = []
    begin, first = lo, -1
    inside = True
    for at, which, end, _ in kept:
        if which == 0:
            begin, first, inside = at, end, True
        elif inside:
            pieces.append(Piece(min(begin, at), at, (first, end)))
            inside = False
    if inside:
        pieces.append(Piece(begin, max(hi, begin), (first, -1)))
    return [piece for piece in pieces if piece.hi - piece.lo >= _SHORTEST]


def _hesse_by_delta(alpha: float) -> Array:
    """d (alpha, d) / d delta, (2, 3), of a line whose frame's error is delta (left, global)."""
    return np.array([[0.0, 0.0, 1.0], [np.cos(alpha), np.sin(alpha), 0.0]])
