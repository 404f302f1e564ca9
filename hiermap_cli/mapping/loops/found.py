"""Loops that were found, with the figures of each: those whose own figures speak for them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.mapping.loops.evidence import Evidence
from hiermap_cli.mapping.loops.graph import Edges, joined, moved, no_edges
from hiermap_cli.mapping.loops.sight import Sights, crossing_share

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LoopConfig
    from hiermap_cli.mapping.loops.correspondences import Candidates
    from hiermap_cli.mapping.loops.fragments import Fragments
    from hiermap_cli.mapping.loops.matching import Matches

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


class Found(NamedTuple):
    """E loops.

    edges: what they say. evidence: what speaks for them. second: (E,) the best other place, of
    this one. chi2: (E,) of the cycle composed over the way that was known. crossing: (E,) share
    of beams through walls.
    """

    edges: Edges
    evidence: Evidence
    second: Array
    chi2: Array
    crossing: Array

    def rows(self, which: Index | Mask) -> Found:
        """Some of them."""
        evidence = Evidence._make(column[which] for column in self.evidence)
        return Found(
            self.edges.rows(which), evidence,
            self.second[which], self.chi2[which], self.crossing[which],
        )  # fmt: skip


def believable(
    fragments: Fragments, sights: Sights, matches: Matches, asked: Candidates, config: LoopConfig
) -> Found:
    """The matches of candidates whose own figures speak for them.

    Walls all parallel tell no place along themselves, however long they are: `cross` is what
    holds the direction that is held least.
    """
    e = matches.evidence
    good = (e.overlap >= config.min_overlap) & (e.walls >= config.min_walls)
    good &= (e.cross >= config.min_cross) & (e.pairs >= config.min_pairs)
    matches = matches.rows(good)
    R = matches.R_i_j
    C = np.linalg.inv(matches.evidence.information + 1e-6 * np.eye(3))
    floor = np.square([config.loop_floor, config.loop_floor, config.loop_floor_angle])
    # The floor is of where the other fragment lies, not of this one's origin.
    at = np.column_stack((R[:, :2], np.zeros(len(R))))
    C = config.loop_inflation * C + moved(np.diag(floor), at)
    i, j = asked.i[matches.candidate], asked.j[matches.candidate]
    crossing = crossing_share(fragments, sights, i, j, R, config)
    found = Found(Edges(i, j, R, C), matches.evidence, matches.second, matches.chi2, crossing)
    return found.rows(crossing < config.max_crossing)


def nothing_found() -> Found:
    """No loops."""
    none = np.zeros(0)
    count = np.zeros(0, dtype=np.int64)
    evidence = Evidence(none, none, count, count, np.zeros((0, 3, 3)))
    return Found(no_edges(), evidence, none, none, none)


def merged(a: Found, b: Found) -> Found:
    """Both, in this order."""
    return Found(
        joined((a.edges, b.edges)),
        Evidence._make(np.concatenate(c) for c in zip(a.evidence, b.evidence, strict=True)),
        np.concatenate((a.second, b.second)),
        np.concatenate((a.chi2, b.chi2)),
        np.concatenate((a.crossing, b.crossing)),
    )
