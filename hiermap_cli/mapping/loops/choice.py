"""Which of the loops that were found are believed.

One witness is none. Where the way there is known so well that the loop only says the same, the
way is the second witness; every other loop needs one that joins other fragments to other
fragments near by and asks for the same correction. Where another correction has nearly as much
to say for itself, all of them wait.

Loops of other fragments contradict each other by way of the path between them, and it may be the
path that is wrong: the filter has matched what does not belong together, and nobody noticed. So
when nothing else is left, loops with many witnesses are closed that no loop of their own
fragments contradicts, and the graph tells whether they hold.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.loops.correspondences import ragged
from hiermap_cli.mapping.loops.graph import Edges, discrepancy, moved, position_variance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LoopConfig
    from hiermap_cli.mapping.loops.found import Found
    from hiermap_cli.mapping.loops.graph import Ways

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


FIRST, NEXT = 3.0, 2.0  # how much less sure a loop may be than the surest, to be closed with it
MANY = 4  # witnesses that may be right against the path, or where the gate is cut off


class Verdict(NamedTuple):
    """Of E loops, (E,) each.

    sure: the way there is a witness. borne: other loops are. witnesses: other loops that ask for
    the same, none of which shares a fragment with it. last: it is believed when nothing else is
    left: borne by loops over so wide a stretch that it may be unlikely, or several witnesses in
    one. against_path: likewise, after all of these: borne by so many that the path may be wrong.
    support: metres of overlap that speak for its correction. rival: of the correction nearest to
    it in support that contradicts it. sigma: metres, of the way there.
    """

    sure: Mask
    borne: Mask
    last: Mask
    against_path: Mask
    witnesses: Index
    support: Array
    rival: Array
    sigma: Array

    def believed(self, closed: Mask, refused: Mask, config: LoopConfig) -> Mask:
        """Which loops are closed next, the `closed` (E,) ones with them: the surest first.

        Those that did not hold against the others are `refused` (E,).

        A way over loops is shorter than the path, and tells better where else the robot may have
        been. So the loops that other loops bear are closed in the order of what was known of the
        place before; those that are unlikely (the odometry has lied and nobody noticed) or alone
        when nothing else is left.
        """
        now = (self.sure | (self.borne & (self.sigma < FIRST * config.sure_sigma))) & ~refused
        for borne in (self.borne, self.last, self.against_path):
            left = borne & ~refused & ~closed
            if left.any() and not (now & ~closed).any():
                now |= borne & ~refused & (self.sigma < NEXT * self.sigma[left].min())
        return now | (closed & (self.sure | self.borne | self.last | self.against_path))


def judge(found: Found, ways: Ways, leaps: Index, config: LoopConfig) -> Verdict:
    """Judges E loops by the way there and by each other.

    Args:
        found: what they say, and their figures.
        ways: how well the fragments know of each other without them.
        leaps: (F,) leaps of the filter on the path up to each fragment.
        config: thresholds.
    """
    loops, overlap, second = found.edges, found.evidence.overlap, found.second
    e, f = _comparable(loops, ways, config)
    asked = discrepancy(ways.frames, loops)
    C = moved(loops.C_i_j, ways.frames[loops.i])
    back = moved(ways.relative(loops.i[e], loops.i[f]), ways.frames[loops.i[e]])
    back += moved(ways.relative(loops.j[e], loops.j[f]), ways.frames[loops.j[e]])
    r = asked[e] - asked[f]
    distance = np.einsum("ni,nij,nj->n", r, np.linalg.inv(C[e] + C[f] + back), r)
    agree = distance < config.agree_gate
    against = distance > config.gate
    n = len(loops.i)
    support = overlap + _sum(agree, e, overlap[f], n) + _sum(agree, f, overlap[e], n)
    clean = found.crossing < config.witness_crossing
    apart = agree & clean[e] & clean[f] & (loops.i[e] != loops.i[f]) & (loops.j[e] != loops.j[f])
    witnesses = np.bincount(e[apart], minlength=n) + np.bincount(f[apart], minlength=n)
    rival = _rival(against, e, f, support)
    shared = (loops.i[e] == loops.i[f]) | (loops.j[e] == loops.j[f])
    at_once = _rival(against & shared, e, f, support)
    known = ways.relative(loops.i, loops.j)
    near = position_variance(known, loops.R_i_j) < config.sure_sigma**2
    near &= known[:, 2, 2] < config.sure_sigma_angle**2
    # Over a broken step the filter is a witness that has looked at single scans only.
    off = se2.between(loops.R_i_j, se2.between(ways.frames[loops.i], ways.frames[loops.j]))
    same = np.hypot(off[:, 0], off[:, 1]) < config.agree
    near |= (
        same & (np.abs(off[:, 2]) < config.agree_angle) & (loops.j - loops.i <= config.least_steps)
    )
    # A place that looks alike lies anywhere in the gate, the same place near its middle.
    distance = ways.chi2(loops)
    likely = distance < config.witness_gate
    spread = np.zeros(n)
    for x in (e[apart], f[apart]):
        np.maximum.at(spread, x, _spread(loops, ways, e[apart], f[apart]))
    sigma = np.sqrt(position_variance(known, loops.R_i_j))
    wide = spread > config.witness_spread
    # Where the gate is cut off, the true place may lie beyond it, and within it one that looks
    # alike: a room, but hardly a wide stretch. Where the filter has leapt, all that it has seen
    # since agrees, be it right or not.
    whole = (sigma < config.max_shift) | (
        (witnesses >= MANY) & wide & (leaps[loops.i] == leaps[loops.j])
    )
    single = (second < config.second) & whole
    clear = single & (rival < config.second * support)
    borne = (witnesses > 0) & clean & clear
    many = (witnesses >= MANY) & clean & single & (at_once < config.second * support)
    return Verdict(
        sure=near & clear,
        borne=borne & likely,
        last=(borne & wide) | (_alone(found, distance, config) & clear),
        against_path=many & wide,
        witnesses=witnesses,
        support=support,
        rival=rival,
        sigma=sigma,
    )


def _rival(against: Mask, e: Index, f: Index, support: Array) -> Array:
    """The most support that a loop has which contradicts one, (E,); pairs e, f that do."""
    rival = np.zeros(len(support))
    np.maximum.at(rival, e[against], support[f[against]])
    np.maximum.at(rival, f[against], support[e[against]])
    return rival


def _alone(found: Found, distance: Array, config: LoopConfig) -> Mask:
    """Loops that are several witnesses in one: constellations that share no wall, each enough.

    And they are where they were expected, at a distance (E,) of next to nothing.
    """
    e = found.evidence
    several = (e.pairs >= config.alone_pairs) & (e.cross >= config.alone_cross)
    clean = (found.crossing < 0.5 * config.witness_crossing) & (found.second < config.alone_second)
    return np.asarray(several & clean & (distance < config.alone_gate))


def _spread(loops: Edges, ways: Ways, e: Index, f: Index) -> Array:
    """How far loops e and f lie apart, at the end where they are nearer: metres, (n,)."""
    at = ways.frames[:, :2]
    apart = [np.hypot(*(at[end[e]] - at[end[f]]).T) for end in (loops.i, loops.j)]
    return np.asarray(np.minimum(apart[0], apart[1]), dtype=float)


def _comparable(loops: Edges, ways: Ways, config: LoopConfig) -> tuple[Index, Index]:
    """Pairs of loops whose ends know of each other well enough to compare what they ask for."""
    order = np.argsort(loops.j, kind="stable")
    end = np.searchsorted(loops.j[order], loops.j[order] + config.near_fragments, side="right")
    first, ahead = ragged(end - np.arange(len(order)) - 1)
    e, f = order[first], order[first + 1 + ahead]
    keep = np.ones(len(e), dtype=bool)
    for a, b in ((loops.i[e], loops.i[f]), (loops.j[e], loops.j[f])):
        C = ways.relative(a, b)
        R = ways.frames[b] - ways.frames[a]
        cos, sin = np.cos(ways.frames[a, 2]), np.sin(ways.frames[a, 2])
        at = np.column_stack((cos * R[:, 0] + sin * R[:, 1], cos * R[:, 1] - sin * R[:, 0]))
        keep &= position_variance(C, at) < config.near_sigma**2
    return e[keep], f[keep]


def _sum(where: Mask, index: Index, value: Array, n: int) -> Array:
    return np.asarray(np.bincount(index[where], value[where], n), dtype=float)
