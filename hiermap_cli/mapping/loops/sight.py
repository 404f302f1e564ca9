"""What speaks against a hypothesis: a robot that would have seen through walls."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LoopConfig
    from hiermap_cli.mapping.loops.fragments import Fragments

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

BEAMS, OWN_BEAMS = 64, 192  # of a fragment, for the other's walls and for its own
MIN_SEEN = 2  # key scans that saw a wall which speaks against a beam
INSIDE = 0.1  # metres that a beam must hit off the ends of a wall
HOLE = 0.4  # metres about a place where a fragment's own beams go through its wall
_APART = 1e4  # metres between the walls in one sorted list


class Sights(NamedTuple):
    """What all F fragments have seen through, in their frames.

    origin, end: (F, BEAMS, 2) of some beams, that end on a segment; fragments with fewer have
    some of them repeatedly, and `any` (F,) is False where there is none. holes: sorted places
    where a fragment's own beams go through one of its walls, `_APART` times the wall plus metres
    along it: an open door, that a glancing look did not tell from its wall.
    """

    origin: Array
    end: Array
    any: Mask
    holes: Array


class _Hits(NamedTuple):
    """Beams that go through walls: row (n,) of the question, beam (n,), wall (n,), along (n,)."""

    row: Index
    beam: Index
    wall: Index
    along: Array


def sights_of(fragments: Fragments, config: LoopConfig) -> Sights:
    """Beams of every fragment, and the holes that they show in its walls."""
    origin, end = _beams(fragments, OWN_BEAMS)
    each = np.arange(len(fragments.centre))
    hits = _hits(fragments, each, origin, end, config)
    origin, end = _beams(fragments, BEAMS)
    known = np.bincount(fragments.of_key[fragments.scan], minlength=len(each)) > 0
    return Sights(origin, end, known, np.sort(_APART * hits.wall + hits.along))


def crossing_share(
    fragments: Fragments, sights: Sights, i: Index, j: Index, R_i_j: Array, config: LoopConfig
) -> Array:
    """The share (n,) of beams of one fragment that would have gone through walls of the other.

    The larger one of both directions.
    """
    there = _share(fragments, sights, i, j, R_i_j, config)
    back = _share(fragments, sights, j, i, se2.invert(R_i_j), config)
    return np.maximum(there, back)


def _beams(fragments: Fragments, count: int) -> tuple[Array, Array]:
    """Origins and ends (F, count, 2), spread evenly over the segments and along them."""
    n = len(fragments.centre)
    of_segment = fragments.of_key[fragments.scan]
    if not len(of_segment):
        return np.zeros((n, count, 2)), np.zeros((n, count, 2))
    start = np.searchsorted(of_segment, np.arange(n + 1))
    spread = (np.arange(count) * np.diff(start)[:, None]) // count
    which = np.minimum(start[:-1, None] + spread, len(of_segment) - 1)
    share = np.array([0.1, 0.5, 0.9])[np.arange(count) % 3, None]
    p, q = fragments.points[which, 0], fragments.points[which, 1]
    return fragments.R_f_k[fragments.scan[which], :2], p + share * (q - p)


def _share(
    fragments: Fragments, sights: Sights, i: Index, j: Index, R_i_j: Array, config: LoopConfig
) -> Array:
    turn = se2.rotation(R_i_j[:, 2]).transpose(0, 2, 1)
    origin = R_i_j[:, None, :2] + sights.origin[j] @ turn
    end = R_i_j[:, None, :2] + sights.end[j] @ turn
    hits = _hits(fragments, i, origin, end, config)
    place = _APART * hits.wall + hits.along
    if len(sights.holes):
        at = np.searchsorted(sights.holes, place)
        above = sights.holes[np.minimum(at, len(sights.holes) - 1)]
        below = sights.holes[np.maximum(at - 1, 0)]
        closed = np.minimum(np.abs(above - place), np.abs(below - place)) > HOLE
    else:
        closed = np.ones(len(place), dtype=bool)
    crossed = np.zeros((len(i), BEAMS), dtype=bool)
    crossed[hits.row[closed], hits.beam[closed]] = True
    return np.where(sights.any[j], crossed.mean(axis=1), 0.0)


def _hits(fragments: Fragments, i: Index, origin: Array, end: Array, config: LoopConfig) -> _Hits:
    """Where beams (n, b, 2) in the frames of fragments i (n,) go through their walls.

    From well before a wall to well behind it, or the other way: no side of it is to see through.
    """
    walls = fragments.solid
    many = walls.start[i + 1] - walls.start[i]
    row = np.repeat(np.arange(len(i)), many)
    wall = np.arange(len(row)) - (np.cumsum(many) - many)[row] + walls.start[i][row]
    keep = walls.seen[wall] >= MIN_SEEN
    row, wall = row[keep], wall[keep]
    n, offset = walls.normal[wall], walls.offset[wall, None]
    before = (origin[row] @ n[:, :, None])[..., 0] - offset
    behind = (end[row] @ n[:, :, None])[..., 0] - offset
    far = config.through
    k, beam = np.nonzero((before * behind < 0) & (np.abs(behind) > far) & (np.abs(before) > far))
    t = before[k, beam] / (before[k, beam] - behind[k, beam])
    row, wall, n = row[k], wall[k], n[k]
    o, e = origin[row, beam], end[row, beam]
    at = o + t[:, None] * (e - o)
    along = at[:, 0] * n[:, 1] - at[:, 1] * n[:, 0]
    inside = (along > walls.lo[wall] + INSIDE) & (along < walls.hi[wall] - INSIDE)
    return _Hits(row[inside], beam[inside], wall[inside], along[inside])
