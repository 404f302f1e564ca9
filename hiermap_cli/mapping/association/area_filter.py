"""One step of an area's filter: match the scan's segments, correct, and add what is new."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.constraint import constrain
from hiermap_cli.estimation.noise import LEAST_ROWS, Surprise, surprise
from hiermap_cli.geometry.points import planar
from hiermap_cli.mapping.area_map import (
    ANCHOR,
    END,
    WALL,
    AreaMap,
    Features,
    Glimpse,
    add_ends,
    add_walls,
    forget,
)
from hiermap_cli.mapping.association.innovations import Innovation
from hiermap_cli.mapping.association.matching import associate
from hiermap_cli.mapping.association.sighting import Viewpoint, object_frames
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config, FilterConfig, ForgetConfig
    from hiermap_cli.estimation.stochastic_map import StochasticMap
    from hiermap_cli.mapping.association.matching import Association
    from hiermap_cli.mapping.association.sighting import Matches
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


class Step(NamedTuple):
    """The area after a scan, and what was matched.

    nis: the normalised innovation squared of `degrees` rows. surprise: how it speaks of the
    noise, None where it says too little. innovation: the rows of the update, None without any.
    """

    area: AreaMap
    matches: Matches
    offered: int
    nis: float
    degrees: int
    surprise: Surprise | None
    innovation: Innovation | None = None


def observe(area: AreaMap, view: SegmentView, key: int, config: Config) -> Step:
    """Correct the area with one scan, then let new walls and ends in."""
    found = associate(area, view, config.association, config.filter)
    return believed(area, view, found, key, config)


def believed(
    area: AreaMap, view: SegmentView, found: Association, key: int, config: Config
) -> Step:
    """The step of a scan whose segments were `associate`d."""
    matches, sighting, constraint = found.matches, found.sighting, found.constraint
    nis, degrees, told, innovation = 0.0, 0, None, None
    along: list[list[float]] = []
    if constraint is not None and sighting is not None:
        V, made = constrain(
            area.V, constraint, lambda V: sighting.innovations(Viewpoint.of(V)), config.update
        )
        nis, degrees = made.nis, len(constraint.innovation)
        S = constraint.gain.S
        innovation = Innovation(constraint.innovation, S.diagonal().copy(), S.diagonal(1).copy())
        if degrees >= LEAST_ROWS:
            shrunk = area.V.covariance[:3, :3] - V.covariance[:3, :3]
            told = surprise(nis, degrees, made.delta[:3], shrunk)
        x = _along(V, view, matches)
        area = AreaMap(V, _seen(area.features, matches, x, key), area.next_uid, area.glimpsed)
        along = x.tolist()
    fresh = _fresh_ends(area.V, view, found, along)
    new = (~found.near & (view.length >= config.filter.min_new_length)).nonzero()[0]
    if len(new):
        first = len(area.features.uid)
        area = add_walls(area, view, new, key)
        fresh += _ends_of_new(area.features, view, new, first)
    if fresh:
        area = _new_ends(area, fresh, key, config.filter)
    return Step(area, matches, found.offered, nis, degrees, told, innovation)


def _seen(f: Features, matches: Matches, x: Array, key: int) -> Features:
    """Extents and counts after a match; x: (a, 2) ends of the segments along their walls."""
    lo, hi, seen, last = f.lo.copy(), f.hi.copy(), f.seen.copy(), f.last.copy()
    np.minimum.at(lo, matches.wall, x[:, 0])
    np.maximum.at(hi, matches.wall, x[:, 1])
    objects = np.concatenate((matches.wall, matches.end))
    seen[objects] = f.seen[objects] + 1  # once a scan, however many of its segments lie on it
    last[objects] = key
    return Features(f.uid, f.kind, f.wall, f.side, lo, hi, seen, last)


def _along(V: StochasticMap, view: SegmentView, matches: Matches) -> Array:
    """Both ends of matched segments along the X axis of their walls, (a, 2)."""
    (origin, unturn), (place, turn) = object_frames(V, matches.wall).table, Viewpoint.of(V)
    ends = place + turn * planar(view.ends).take(matches.segment, axis=0)
    return np.asarray(((ends - origin[:, None]) * unturn[:, None]).real)


class FreshEnd(NamedTuple):
    """An end of a segment that is no known end.

    wall: object index. x: along the wall. known: x of the wall's known ends of that side.
    """

    wall: int
    side: int
    x: float
    sigma: float
    known: tuple[float, ...] = ()


def _fresh_ends(
    V: StochasticMap, view: SegmentView, found: Association, along: list[list[float]]
) -> list[FreshEnd]:
    """The ends of matched segments that were not matched with a known end.

    Like all that concerns single ends this is written out: a scan has only a few of them.
    """
    m = found.matches
    matched = set(zip(m.end_segment.tolist(), m.end_side.tolist(), strict=True))
    kind = view.end_kind.tolist()
    fresh = []
    for segment, wall, x in zip(m.segment.tolist(), m.wall.tolist(), along, strict=True):
        for side in (0, 1):
            if kind[segment][side] != END_OPEN and (segment, side) not in matched:
                sigma = float(view.end_sigma[segment, side])
                ends = found.known.get((segment, side), ())
                known = tuple(_place_on_wall(V, wall, end) for end in ends)
                fresh.append(FreshEnd(wall, side, x[side], sigma, known))
    return fresh


def _place_on_wall(V: StochasticMap, wall: int, end: int) -> float:
    """X of an end along its wall."""
    x_w, y_w, theta = map(float, V.poses[1 + wall])
    x, y, _ = map(float, V.poses[1 + end])
    return math.cos(theta) * (x - x_w) + math.sin(theta) * (y - y_w)


def _ends_of_new(f: Features, view: SegmentView, segments: Index, first: int) -> list[FreshEnd]:
    """The ends of segments that founded walls, of which `first` is the first one's object."""
    kind, sigma = view.end_kind.tolist(), view.end_sigma.tolist()
    return [
        FreshEnd(wall, side, float(extent[wall]), sigma[segment][side])
        for wall, segment in enumerate(segments.tolist(), first)
        for side, extent in ((0, f.lo), (1, f.hi))
        if kind[segment][side] != END_OPEN
    ]


def _new_ends(area: AreaMap, fresh: list[FreshEnd], key: int, config: FilterConfig) -> AreaMap:
    """Ends that were glimpsed shortly before enter V; the others are remembered as glimpses.

    A known end of the same wall and side that is near, but did not pass its gate, forbids a
    second one beside it.
    """
    uid = area.features.uid
    glimpsed = [g for g in area.glimpsed if g.key >= key - config.end_patience]
    first, again, explained = [], [], set()
    for end in fresh:
        if any(abs(x - end.x) < config.end_spacing for x in end.known):
            continue
        wall = int(uid[end.wall])
        same = [
            i
            for i, g in enumerate(glimpsed)
            if g.wall == wall and g.side == end.side and abs(g.x - end.x) < 4.0 * end.sigma
        ]
        explained.update(same)
        if same:
            again.append(end)
        else:
            first.append(Glimpse(wall, end.side, end.x, key))
    left = [g for i, g in enumerate(glimpsed) if i not in explained]
    area = AreaMap(area.V, area.features, area.next_uid, (*left, *first))
    if not again:
        return area
    return add_ends(
        area,
        np.array([end.wall for end in again]),
        np.array([end.x for end in again]),
        np.array([end.sigma for end in again]),
        np.array([end.side for end in again]),
        key,
    )


def forget_unseen(area: AreaMap, key: int, config: ForgetConfig) -> tuple[AreaMap, int]:
    """Forget what has not been seen for long, against how often it ever was.

    An object seen n times is kept for `patience * n` key scans, and for good after `enough`
    sightings. Ends go with their wall. Returns how many were forgotten.
    """
    f = area.features
    unseen = key - f.last
    drop = (f.kind != ANCHOR) & (f.seen < config.enough) & (unseen > config.patience * f.seen)
    gone = f.uid[drop & (f.kind == WALL)]
    drop |= (f.kind == END) & (f.wall[:, None] == gone).any(axis=1)
    if not drop.any():
        return area, 0
    return forget(area, drop), int(drop.sum())
