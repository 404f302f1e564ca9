"""What speaks against a hypothesis: a robot that would have seen through walls."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LoopConfig
    from hiermap_cli.mapping.fragments import Fragments

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

BEAMS = 64  # of a fragment
MIN_SEEN = 2  # key scans that saw a wall which speaks against a beam
INSIDE = 0.1  # metres that a beam must hit off the ends of a wall


class Beams(NamedTuple):
    """Some beams of all F fragments in their frames: origin, end (F, BEAMS, 2).

    A beam ends on a segment that was seen; fragments with fewer have some of them repeatedly,
    and `any` (F,) is False where there is none.
    """

    origin: Array
    end: Array
    any: NDArray[np.bool_]


def beams_of(fragments: Fragments) -> Beams:
    """Beams spread evenly over the segments of each fragment, to places on them in turn."""
    count = len(fragments.centre)
    of_segment = fragments.of_key[fragments.scan]
    start = np.searchsorted(of_segment, np.arange(count + 1))
    many = np.diff(start)
    spread = (np.arange(BEAMS) * many[:, None]) // BEAMS
    which = np.minimum(start[:-1, None] + spread, max(len(of_segment) - 1, 0))
    if not len(of_segment):
        return Beams(
            np.zeros((count, BEAMS, 2)), np.zeros((count, BEAMS, 2)), np.zeros(count, dtype=bool)
        )
    share = np.array([0.1, 0.5, 0.9])[np.arange(BEAMS) % 3, None]
    p, q = fragments.points[which, 0], fragments.points[which, 1]
    origin = fragments.R_f_k[fragments.scan[which], :2]
    return Beams(origin, p + share * (q - p), many > 0)


def crossing_share(
    fragments: Fragments, beams: Beams, i: Index, j: Index, R_i_j: Array, config: LoopConfig
) -> Array:
    """The share (n,) of beams of one fragment that would have gone through walls of the other.

    The larger one of both directions.
    """
    there = _share(fragments, beams, i, j, R_i_j, config)
    back = _share(fragments, beams, j, i, se2.invert(R_i_j), config)
    return np.maximum(there, back)


def _share(
    fragments: Fragments, beams: Beams, i: Index, j: Index, R_i_j: Array, config: LoopConfig
) -> Array:
    walls = fragments.walls
    turn = se2.rotation(R_i_j[:, 2])
    origin = R_i_j[:, None, :2] + np.einsum("nij,nkj->nki", turn, beams.origin[j])
    end = R_i_j[:, None, :2] + np.einsum("nij,nkj->nki", turn, beams.end[j])
    many = walls.start[i + 1] - walls.start[i]
    h = np.repeat(np.arange(len(i)), many)
    wall = np.arange(len(h)) - (np.cumsum(many) - many)[h] + walls.start[i][h]
    keep = walls.seen[wall] >= MIN_SEEN
    h, wall = h[keep], wall[keep]
    n = walls.normal[wall]
    before = origin[h] @ n[:, :, None]
    behind = end[h] @ n[:, :, None]
    before, behind = (
        before[..., 0] - walls.offset[wall, None],
        behind[..., 0] - walls.offset[wall, None],
    )
    # From well before it to well behind it, or the other way: walls have no side to see through.
    far = config.through
    hit = (before * behind < 0) & (np.abs(behind) > far) & (np.abs(before) > far)
    row, beam = np.nonzero(hit)
    t = before[row, beam] / (before[row, beam] - behind[row, beam])
    o, e = origin[h[row], beam], end[h[row], beam]
    at = o + t[:, None] * (e - o)
    along = at[:, 0] * n[row, 1] - at[:, 1] * n[row, 0]
    w = wall[row]
    inside = (along > walls.lo[w] + INSIDE) & (along < walls.hi[w] - INSIDE)
    crossed = np.zeros((len(i), BEAMS), dtype=bool)
    crossed[h[row[inside]], beam[inside]] = True
    return np.where(beams.any[j], crossed.mean(axis=1), 0.0)
