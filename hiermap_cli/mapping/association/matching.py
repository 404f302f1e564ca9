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


class Pairs(NamedTuple):
    """Pairs that passed their own gates, by segment, best first.

    at: (g,) which of the pairs within reach. cost: (g,) lower is better.
    """

    segment: Index
    at: Index
    cost: Array

    def select(self, which: Index) -> Pairs:
        """Some of the pairs."""
        return Pairs(self.segment.take(which), self.at.take(which), self.cost.take(which))


def associate(
    area: AreaMap, view: SegmentView, config: AssociationConfig, filter_config: FilterConfig
) -> Association:
    """Segments to walls by joint compatibility, then their ends to the ends of those walls.

    All pairs within reach, and the ends that could go with them, are predicted at one stroke:
    gates, joint compatibility and the update all choose among these rows.
    """
    frames, seen = object_frames(area.V), Seen.of(view)
    long = view.length >= filter_config.min_match_length
    offered = int(np.count_nonzero(long))
    near = np.zeros(len(view.length), dtype=bool)
    nothing = Association(_NO_MATCHES, None, None, near, offered, {})
    reached = within_reach(area, frames, view, seen, config, long)
    if not len(reached.segment):
        return nothing
    offers = _offered(area, view, reached)
    sighting = Sighting.of(frames, seen, offers.matches)
    told = predicted(area.V, *match_rows(area.V, sighting, view, offers.matches))
    pairs = _gated(told, reached, config)
    if not len(pairs.at):
        return nothing
    near[pairs.segment] = True
    pairs = _longest(pairs, view)
    best = pairs.at.take(_first(pairs.segment))
    found = _with_ends(told, sighting, offers, best, config)
    z = found.constraint.gain.whiten(found.constraint.innovation)[: 2 * len(best)]
    if config.joint and float(z @ z) > chi_square(config.gate, 2 * len(best)):
        few = _best_few(pairs)
        best = few.at.take(_jointly_compatible(told, few, config))
        found = _with_ends(told, sighting, offers, best, config)
    return Association(found.matches, found.sighting, found.constraint, near, offered, found.known)


def within_reach(
    area: AreaMap,
    frames: Frames,
    view: SegmentView,
    seen: Seen,
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
    viewpoint = Viewpoint.of(area.V)
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


def _gated(told: Prediction, reached: Reached, config: AssociationConfig) -> Pairs:
    """The pairs that pass their own gates, chi-square with 2 degrees of freedom.

    They are ranked by `d2 + log det S` less a bonus for overlap.
    """
    rows = 2 * len(reached.segment)
    diagonal = told.S.diagonal()
    S_yy, S_tt, S_yt = diagonal[0:rows:2], diagonal[1:rows:2], told.S.diagonal(1)[0:rows:2]
    y, t = told.innovation[0:rows:2], told.innovation[1:rows:2]
    det = S_yy * S_tt - S_yt * S_yt
    d2 = (S_tt * y * y - 2.0 * S_yt * y * t + S_yy * t * t) / det
    cost = d2 + np.log(det) - config.overlap_bonus * reached.overlap
    order = np.lexsort((cost, reached.segment))
    order = order[d2.take(order) < chi_square(config.gate, 2)]
    return Pairs(reached.segment.take(order), order, cost.take(order))


def _longest(pairs: Pairs, view: SegmentView) -> Pairs:
    """The pairs of the longest segments, where there are more than can be tried together."""
    segments = pairs.segment.take(_first(pairs.segment))
    if len(segments) <= MAX_SEGMENTS:
        return pairs
    order = np.argsort(-view.length.take(segments), kind="stable")
    return pairs.select(np.isin(pairs.segment, segments[order[:MAX_SEGMENTS]]).nonzero()[0])


def _best_few(pairs: Pairs) -> Pairs:
    """The best few candidates of every segment."""
    first = _first(pairs.segment)
    counts = np.diff(np.append(first, len(pairs.segment)))
    rank = np.arange(len(pairs.segment)) - np.repeat(first, counts)
    return pairs.select((rank < MAX_CANDIDATES).nonzero()[0])


def _first(segment: Index) -> Index:
    """Where each segment's run begins in a list sorted by segment: its best candidate."""
    new = np.empty(len(segment), dtype=bool)
    new[:1] = True
    np.not_equal(segment[1:], segment[:-1], out=new[1:])
    return new.nonzero()[0]


def _rows(pair: Index) -> Index:
    """The rows (y, theta) of pairs."""
    return np.asarray((2 * pair[:, None] + np.arange(2)).ravel())


def _jointly_compatible(told: Prediction, tried: Pairs, config: AssociationConfig) -> Index:
    """The best pairs less one in four at most that spoil them, else branch and bound over all."""
    rows = _rows(tried.at)
    innovation = told.innovation.take(rows).reshape(-1, 2)
    S = told.S.take(rows, axis=0).take(rows, axis=1)
    candidates = Candidates(tried.segment, tried.cost, innovation, S)
    best = _first(tried.segment).tolist()
    kept = without_the_worst(candidates, best, config.gate, len(best) // 4)
    if kept is None:
        kept = joint_compatibility(candidates, config.gate)
    return np.array(kept, dtype=np.int64)


class _Chosen(NamedTuple):
    """As in `Association`."""

    matches: Matches
    sighting: Sighting
    constraint: Constraint
    known: KnownEnds


def _with_ends(
    told: Prediction,
    sighting: Sighting,
    all_pairs: Offered,
    chosen: Index,
    config: AssociationConfig,
) -> _Chosen:
    """The chosen pairs, and of the ends of their walls the nearest, one to one, within the gate."""
    pairs = all_pairs.matches
    among = np.zeros(len(pairs.wall), dtype=bool)
    among[chosen] = True
    ends = among.take(all_pairs.pair).nonzero()[0]
    seen = list(
        zip(pairs.end_segment.take(ends).tolist(), pairs.end_side.take(ends).tolist(), strict=True)
    )
    end = pairs.end.take(ends).tolist()
    rows = 2 * len(pairs.wall) + ends
    d2 = np.square(told.innovation.take(rows)) / told.S.diagonal().take(rows)
    kept = ends.take(_one_to_one(seen, end, d2.tolist(), chi_square(config.gate, 1)))
    known: KnownEnds = {}
    for which, one in zip(seen, end, strict=True):
        known.setdefault(which, []).append(one)
    matches = Matches(
        pairs.segment.take(chosen),
        pairs.wall.take(chosen),
        pairs.end_segment.take(kept),
        pairs.end_side.take(kept),
        pairs.end.take(kept),
    )
    rows = np.concatenate((_rows(chosen), 2 * len(pairs.wall) + kept))
    return _Chosen(matches, sighting.select(chosen, kept), told.constraint(rows), known)


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
