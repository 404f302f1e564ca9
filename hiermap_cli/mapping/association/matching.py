"""Which wall of the area is each segment of a scan, and which of its ends each end."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.association import (
    Candidates,
    chi_square,
    joint_compatibility,
    without_the_worst,
)
from hiermap_cli.estimation.constraint import predicted
from hiermap_cli.mapping.area_map import WALL
from hiermap_cli.mapping.association.sighting import (
    Frames,
    Matches,
    Seen,
    Sighting,
    Viewpoint,
    match_rows,
    object_frames,
)
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import AssociationConfig, FilterConfig
    from hiermap_cli.estimation.constraint import Constraint, Prediction
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

_NONE = np.zeros(0, dtype=np.int64)
_NO_MATCHES = Matches(_NONE, _NONE, _NONE, _NONE, _NONE)
MAX_SEGMENTS, MAX_CANDIDATES = 10, 3


class Association(NamedTuple):
    """matches: what was found, sighting: how it is seen, and `constraint`: its rows, ready.

    Near: (s,) whether a segment lies near enough to some wall that it must not found a new one.
    offered: how many segments could have been matched. known: the known ends (object indices) of
    the wall and side of each end seen, `(segment, side)`, within their gates or not.
    """

    matches: Matches
    sighting: Sighting | None
    constraint: Constraint | None
    near: NDArray[np.bool_]
    offered: int
    known: KnownEnds


KnownEnds = dict[tuple[int, int], list[int]]


class Reached(NamedTuple):
    """Segments that may lie on walls, c pairs sorted by segment.

    overlap: (c,) share of the segment that lies within the wall's extent, negative where they
    are apart, in [-1, 1].
    """

    segment: Index
    wall: Index
    overlap: Array


class Offered(NamedTuple):
    """All that may be matched: pairs within reach, and ends that would go with them.

    pair: (b,) the pair with which each end goes.
    """

    matches: Matches
    pair: Index


class Pair(NamedTuple):
    """A pair that passed its own gate. at: which of those within reach. cost: lower is better."""

    cost: float
    at: int


Gated = dict[int, list[Pair]]  # of each segment, in order, its pairs, the best first


def associate(
    area: AreaMap, view: SegmentView, config: AssociationConfig, filter_config: FilterConfig
) -> Association:
    """Segments to walls by joint compatibility, then their ends to the ends of those walls.

    All pairs within reach, and the ends that could go with them, are predicted at one stroke:
    gates, joint compatibility and the update all choose among these rows.
    """
    frames, seen, viewpoint = object_frames(area.V), Seen.of(view), Viewpoint.of(area.V)
    long = view.length >= filter_config.min_match_length
    offered = int(np.count_nonzero(long))
    near = np.zeros(len(long), dtype=bool)
    nothing = Association(_NO_MATCHES, None, None, near, offered, {})
    reached = within_reach(area, frames, view, seen, viewpoint, config, long)
    if not len(reached.segment):
        return nothing
    offers = _offered(area, view, reached)
    sighting = Sighting.of(frames, seen, offers.matches)
    told = predicted(area.V, *match_rows(area.V, sighting, view, offers.matches))
    gated = _gated(told, reached, config)
    if not gated:
        return nothing
    near[list(gated)] = True
    tried = _longest(gated, view)
    best = [pairs[0].at for pairs in tried.values()]
    found = _with_ends(told, sighting, offers, best, config)
    z = found.constraint.gain.whiten(found.constraint.innovation)[: 2 * len(best)]
    if config.joint and float(z @ z) > chi_square(config.gate, 2 * len(best)):
        best = _jointly_compatible(told, tried, config)
        found = _with_ends(told, sighting, offers, best, config)
    return Association(found.matches, found.sighting, found.constraint, near, offered, found.known)


def within_reach(
    area: AreaMap,
    frames: Frames,
    view: SegmentView,
    seen: Seen,
    viewpoint: Viewpoint,
    config: AssociationConfig,
    long: NDArray[np.bool_],
) -> Reached:
    """Pairs of the segments that are long enough (s,) with walls, within angle, offset, extent.

    Segment and wall are compared as each lies to the robot: by its distance from the robot and
    its reach along itself from the foot of the perpendicular, which an error of the robot's
    heading does not change.
    """
    f = area.features
    walls = (f.kind == WALL).nonzero()[0]
    F = frames.select(walls)
    # The robot along and aside of each wall, the segments along and aside of the robot.
    place = F.local(viewpoint.place)
    unturn = seen.direction.conj()
    along, aside = (unturn[:, None] * seen.ends).real, (unturn * seen.centre).imag
    lo, hi = f.lo.take(walls) - place.real, f.hi.take(walls) - place.real
    gap = np.maximum(lo - along[:, 1:], along[:, :1] - hi)
    facing = (seen.direction[:, None] * (viewpoint.turn * F.unturn)).real
    reached = facing > math.cos(config.max_angle)
    reached &= np.abs(aside[:, None] + place.imag) < config.max_offset
    reached &= gap < config.max_gap
    reached &= long[:, None]
    segment, j = reached.nonzero()
    overlap = -gap[segment, j] / view.length.take(segment)
    return Reached(segment, walls.take(j), np.minimum(np.maximum(overlap, -1.0), 1.0))


def _offered(area: AreaMap, view: SegmentView, reached: Reached) -> Offered:
    """The pairs with every end of their segments to every known end of their walls and sides."""
    f = area.features
    pair, end = (f.uid.take(reached.wall)[:, None] == f.wall).nonzero()
    segment, side = reached.segment.take(pair), f.side.take(end)
    seen = (view.end_kind[segment, side] != END_OPEN).nonzero()[0]
    matches = Matches(
        reached.segment, reached.wall, segment.take(seen), side.take(seen), end.take(seen)
    )
    return Offered(matches, pair.take(seen))


def _gated(told: Prediction, reached: Reached, config: AssociationConfig) -> Gated:
    """The pairs that pass their own gates, chi-square with 2 degrees of freedom.

    They are ranked by `d2 + log det S` less a bonus for overlap. Like all that concerns single
    pairs this is written out: a scan has only a few of them.
    """
    nu, diagonal = told.innovation.tolist(), told.S.diagonal().tolist()
    beside, overlap = told.S.diagonal(1).tolist(), reached.overlap.tolist()
    gate, bonus = chi_square(config.gate, 2), config.overlap_bonus
    gated: Gated = {}
    for at, segment in enumerate(reached.segment.tolist()):
        y, t = nu[2 * at], nu[2 * at + 1]
        S_yy, S_tt, S_yt = diagonal[2 * at], diagonal[2 * at + 1], beside[2 * at]
        det = S_yy * S_tt - S_yt * S_yt
        d2 = (S_tt * y * y - 2.0 * S_yt * y * t + S_yy * t * t) / det
        if d2 < gate:
            pair = Pair(d2 + math.log(det) - bonus * overlap[at], at)
            gated.setdefault(segment, []).append(pair)
    for pairs in gated.values():
        pairs.sort()
    return gated


def _longest(gated: Gated, view: SegmentView) -> Gated:
    """The pairs of the longest segments, where there are more than can be tried together."""
    if len(gated) <= MAX_SEGMENTS:
        return gated
    longest = sorted(gated, key=lambda segment: -view.length[segment])[:MAX_SEGMENTS]
    return {segment: gated[segment] for segment in sorted(longest)}


def _rows(pairs: list[int]) -> list[int]:
    """The rows (y, theta) of pairs."""
    return [row for pair in pairs for row in (2 * pair, 2 * pair + 1)]


def _jointly_compatible(told: Prediction, tried: Gated, config: AssociationConfig) -> list[int]:
    """The best pairs less one in four at most that spoil them, else branch and bound.

    Of every segment the best few are tried.
    """
    few = [(segment, pair) for segment, all_ in tried.items() for pair in all_[:MAX_CANDIDATES]]
    segments = [segment for segment, _ in few]
    rows = np.array(_rows([pair.at for _, pair in few]))
    candidates = Candidates(
        np.array(segments),
        np.array([pair.cost for _, pair in few]),
        told.innovation.take(rows).reshape(-1, 2),
        told.S.take(rows, axis=0).take(rows, axis=1),
    )
    best = [segments.index(segment) for segment in tried]
    kept = without_the_worst(candidates, best, config.gate, len(best) // 4)
    if kept is None:
        kept = joint_compatibility(candidates, config.gate)
    return [few[i][1].at for i in kept]


class _Chosen(NamedTuple):
    """As in `Association`."""

    matches: Matches
    sighting: Sighting
    constraint: Constraint
    known: KnownEnds


def _with_ends(
    told: Prediction,
    sighting: Sighting,
    offers: Offered,
    chosen: list[int],
    config: AssociationConfig,
) -> _Chosen:
    """The chosen pairs, and of the ends of their walls the nearest, one to one, within the gate."""
    pairs, among, n = offers.matches, set(chosen), 2 * len(offers.matches.wall)
    ends = [i for i, pair in enumerate(offers.pair.tolist()) if pair in among]
    segment, side = pairs.end_segment.tolist(), pairs.end_side.tolist()
    seen = [(segment[i], side[i]) for i in ends]
    offered = pairs.end.tolist()
    end = [offered[i] for i in ends]
    all_d2 = (np.square(told.innovation[n:]) / told.S.diagonal()[n:]).tolist()
    d2 = [all_d2[i] for i in ends]
    kept = [ends[i] for i in _one_to_one(seen, end, d2, chi_square(config.gate, 1))]
    known: KnownEnds = {}
    for which, one in zip(seen, end, strict=True):
        known.setdefault(which, []).append(one)
    at_pairs, at_ends = np.array(chosen), np.array(kept, dtype=np.int64)
    matches = Matches(
        pairs.segment.take(at_pairs),
        pairs.wall.take(at_pairs),
        pairs.end_segment.take(at_ends),
        pairs.end_side.take(at_ends),
        pairs.end.take(at_ends),
    )
    rows = np.array(_rows(chosen) + [n + i for i in kept])
    return _Chosen(matches, sighting.select(at_pairs, at_ends), told.constraint(rows), known)


def _one_to_one(
    seen: list[tuple[int, int]], known: list[int], d2: list[float], gate: float
) -> list[int]:
    """Which of the pairs of ends are kept: the nearest first, no end of either kind twice."""
    taken: set[object] = set()
    kept = []
    for i in sorted(range(len(d2)), key=d2.__getitem__):
        if d2[i] > gate:
            break
        if seen[i] not in taken and known[i] not in taken:
            taken.update((seen[i], known[i]))
            kept.append(i)
    return sorted(kept)
