"""Loops at the environment level, off line: where has the robot been before?

When the filter is through with the log, the path is cut into fragments, the walls of fragments
that may have seen the same are laid on each other, and what is believed of the loops found moves
the fragments. Every round knows better than the one before where to look: the ways over the
loops are shorter than the path.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hiermap_cli.mapping.loops.candidates import among, candidates, nothing_asked
from hiermap_cli.mapping.loops.chain import broken_between, carried, chain, steps_of
from hiermap_cli.mapping.loops.choice import Verdict, judge
from hiermap_cli.mapping.loops.found import Found, believable, merged, nothing_found
from hiermap_cli.mapping.loops.fragments import Fragments, fragments_of
from hiermap_cli.mapping.loops.graph import Edges, chi2, joined, solved, ways
from hiermap_cli.mapping.loops.matching import match
from hiermap_cli.mapping.loops.sight import sights_of
from hiermap_cli.mapping.model import Event

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config, LoopConfig
    from hiermap_cli.estimation.noise import NoiseScale
    from hiermap_cli.mapping.keyscans import KeyScans

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


class Figures(NamedTuple):
    """What a loop is believed by.

    overlap: metres of wall on wall. cross: metres of it in the direction held least. walls:
    number of them. pairs: constellations of two walls that are not parallel, each wall in one.
    crossing: share of beams through walls. second: the best other place, of this one. chi2: of
    the cycle composed over the way there. witnesses: other loops that ask for the same.
    """

    overlap: float
    cross: float
    walls: int
    pairs: int
    crossing: float
    second: float
    chi2: float
    witnesses: int


class Loop(NamedTuple):
    """Two key scans that know of each other by what both have seen.

    R_i_j: (3,). covariance: (3, 3) of `log(R_i_j R_i_j_hat^-1)`, in the frame of key scan i.
    """

    key_i: int
    key_j: int
    R_i_j: Array
    covariance: Array
    figures: Figures


class LoopResult(NamedTuple):
    """Corrected key poses (K, 3) in g, the loops that were closed, and all that was thought of."""

    poses: Array
    edges: tuple[Loop, ...]
    events: tuple[Event, ...]


def close_loops(keyscans: KeyScans, poses: Array, config: Config, noise: NoiseScale) -> LoopResult:
    """Finds and closes the loops of a whole log.

    Args:
        keyscans: of the log.
        poses: (K, 3) the filter's key poses in g.
        config: of the run.
        noise: as the filter found it.
    """
    poses = np.asarray(poses, dtype=float)
    if len(poses) < 2 or not config.loops.enabled:
        return LoopResult(poses, (), ())
    c = config.loops
    steps = steps_of(keyscans, poses, config, noise)
    fragments = fragments_of(keyscans, poses, steps.broken, c)
    sights = sights_of(fragments, c)
    path = chain(fragments, poses, steps, config, noise)
    broken = broken_between(fragments, steps)
    leaps = np.asarray(np.cumsum(steps.leapt), dtype=np.int64)[fragments.centre]
    frames = poses[fragments.centre]
    found, asked = nothing_found(), nothing_asked()
    closed, refused = np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)
    verdict: Verdict | None = None
    for _ in range(c.rounds):
        known = found.edges.rows(closed)
        net = ways(frames, joined((path, known)))
        anew = asked.news(candidates(fragments, net, known, broken, c), c)
        asked = asked.joined(anew)
        # What is not asked for again still stands as it was found.
        kept = closed | ~among(found.edges, anew, len(frames))
        seen = believable(fragments, sights, match(fragments, anew, c), anew, c)
        found = merged(found.rows(kept), seen)
        new = np.zeros(len(seen.chi2), dtype=bool)
        before = np.concatenate((closed[kept], new))
        refused = np.concatenate((refused[kept], new))
        verdict = judge(found, net, leaps, c)
        believed = verdict.believed(before, refused, c)
        frames, closed = _settled(frames, path, found, believed, c)
        refused |= believed & ~closed
        if not (believed & ~before).any():
            break
    assert verdict is not None
    if not closed.any():
        return LoopResult(poses, *_told(keyscans, fragments, found, verdict, closed, refused))
    moved = carried(fragments, poses, frames, steps.covariance)
    edges, events = _told(keyscans, fragments, found, verdict, closed, refused)
    return LoopResult(moved, edges, events)


def _settled(
    frames: Array, path: Edges, found: Found, believed: Mask, config: LoopConfig
) -> tuple[Array, Mask]:
    """The frames with the loops believed, and which of them hold against all others."""
    closed = believed.copy()
    for _ in range(2):
        loops = found.edges.rows(closed)
        both = joined((path, loops))
        robust = np.arange(len(both.i)) >= len(path.i)
        frames = solved(frames, both, robust, config.loss_scale)
        bad = chi2(frames, loops) > config.gate
        if not bad.any():
            break
        closed[np.flatnonzero(closed)[bad]] = False
    return frames, closed


def _told(
    keyscans: KeyScans, fragments: Fragments, found: Found, verdict: Verdict,
    closed: Mask, refused: Mask,
) -> tuple[tuple[Loop, ...], tuple[Event, ...]]:  # fmt: skip
    """The loops closed, and an event for each one found."""
    loops: list[Loop] = []
    events: list[Event] = []
    e = found.evidence
    for k in range(len(closed)):
        i, j = int(found.edges.i[k]), int(found.edges.j[k])
        figures = Figures(
            float(e.overlap[k]), float(e.cross[k]), int(e.walls[k]), int(e.pairs[k]),
            float(found.crossing[k]), float(found.second[k]), float(found.chi2[k]),
            int(verdict.witnesses[k]),
        )  # fmt: skip
        a, b = int(fragments.centre[i]), int(fragments.centre[j])
        if closed[k]:
            kind = "loop_closed"
            loops.append(Loop(a, b, found.edges.R_i_j[k], found.edges.C_i_j[k], figures))
        else:
            kind = "loop_refused" if refused[k] else "loop_held_back"
        details: dict[str, Any] = {"to": int(keyscans.stamps_ns[a]) * 1e-9, **figures._asdict()}
        events.append(Event(int(keyscans.stamps_ns[b]), kind, details))
    return tuple(loops), tuple(events)
