"""One step of an area's filter: match the scan's segments, correct, and add what is new."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.noise import LEAST_ROWS, Surprise, surprise
from hiermap_cli.estimation.stochastic_map import StochasticMap, constrain
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import (
    ANCHOR,
    END,
    WALL,
    AreaMap,
    add_ends,
    add_walls,
    forget,
    innovations,
    seen_frames,
)
from hiermap_cli.mapping.innovations import Innovation
from hiermap_cli.mapping.matching import associate
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config, FilterConfig, ForgetConfig
    from hiermap_cli.mapping.area_map import Matches
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
    matches, constraint = found.matches, found.constraint
    nis, degrees, told, innovation = 0.0, 0, None, None
    along = np.zeros((0, 2))
    if constraint is not None and not matches.empty():
        objects = np.concatenate((matches.wall, matches.end))
        V, nis = constrain(
            area.V,
            constraint,
            lambda V: innovations(seen_frames(V, objects), view, matches),
            config.update,
        )
        degrees = len(constraint.innovation)
        S = constraint.gain.S
        innovation = Innovation(constraint.innovation, S.diagonal().copy(), S.diagonal(1).copy())
        if degrees >= LEAST_ROWS:
            told = _surprise(area.V, V, nis, degrees)
        area = AreaMap(V, area.features, area.next_uid, area.glimpsed)
        along = _along(area, view, matches.segment, matches.wall)
        area = _seen(area, matches, along, key)
    known = len(area.features.uid)
    new = ~found.near & (view.length >= config.filter.min_new_length)
    founded = new.nonzero()[0]
    area = add_walls(area, view, founded, key)
    area = _new_ends(area, view, matches, founded, known, key, config, along)
    return Step(area, matches, found.offered, nis, degrees, told, innovation)


def _surprise(before: StochasticMap, after: StochasticMap, nis: float, rows: int) -> Surprise:
    delta_r = se2.log(se2.compose(after.robot, se2.invert(before.robot)))
    if before.coordinates == "additive":
        delta_r = after.robot - before.robot
        delta_r[2] = se2.wrap_one(float(delta_r[2]))
    return surprise(nis, rows, delta_r, before.covariance[:3, :3] - after.covariance[:3, :3])


def _seen(area: AreaMap, matches: Matches, x: Array, key: int) -> AreaMap:
    """Extents and counts after a match; x: (a, 2) ends of the segments along their walls."""
    f = area.features
    lo, hi, seen, last = f.lo.copy(), f.hi.copy(), f.seen.copy(), f.last.copy()
    np.minimum.at(lo, matches.wall, x[:, 0])
    np.maximum.at(hi, matches.wall, x[:, 1])
    objects = np.concatenate((matches.wall, matches.end))
    seen[objects] = f.seen[objects] + 1  # once a scan, however many of its segments lie on it
    last[objects] = key
    features = f._replace(lo=lo, hi=hi, seen=seen, last=last)
    return AreaMap(area.V, features, area.next_uid, area.glimpsed)


def _along(area: AreaMap, view: SegmentView, segments: Index, walls: Index) -> Array:
    """Both ends of segments along the X axis of walls, (k, 2)."""
    F = seen_frames(area.V, walls)
    dx, dy = view.ends[segments, :, 0] - F.x[:, None], view.ends[segments, :, 1] - F.y[:, None]
    return np.asarray(F.cos[:, None] * dx + F.sin[:, None] * dy)


def _new_ends(
    area: AreaMap,
    view: SegmentView,
    matches: Matches,
    founded: Index,
    known: int,
    key: int,
    config: Config,
    along: Array,
) -> AreaMap:
    """Ends that no known end explains: of matched segments, and of those that found a wall."""
    fresh = view.end_kind != END_OPEN
    fresh[matches.end_segment, matches.end_side] = False
    segments = np.concatenate((matches.segment, founded))
    i, side = np.nonzero(fresh[segments])
    if not len(i):
        return area
    new_walls = known + np.arange(len(founded))
    walls = np.concatenate((matches.wall, new_walls))
    if len(founded):
        along = np.concatenate((along, _along(area, view, founded, new_walls)))
    x = along[i, side]
    # A known end of the same wall and side that is near, but did not pass its gate, forbids a
    # second one beside it.
    f = area.features
    a, b = np.nonzero(
        np.where(f.kind == END, 2 * f.wall + f.side, -1) == (2 * f.uid[walls[i]] + side)[:, None]
    )
    if len(a):
        R_w_e = se2.between(area.V.poses[1 + walls[i[a]]], area.V.poses[1 + b])
        beside = np.zeros(len(i), dtype=bool)
        beside[a[np.abs(R_w_e[:, 0] - x[a]) < config.filter.end_spacing]] = True
        i, side, x = i[~beside], side[~beside], x[~beside]
    sigma = view.end_sigma[segments[i], side]
    seen_twice, glimpsed = _glimpsed_before(area, walls[i], side, x, sigma, key, config.filter)
    area = replace(area, glimpsed=glimpsed)
    at = seen_twice.nonzero()[0]
    return add_ends(area, walls[i[at]], x[at], sigma[at], side[at], key)


def _glimpsed_before(
    area: AreaMap,
    walls: Index,
    sides: Index,
    x: Array,
    sigma: Array,
    key: int,
    config: FilterConfig,
) -> tuple[NDArray[np.bool_], Array]:
    """Which of the new ends were glimpsed shortly before, and the glimpses to remember now."""
    old = area.glimpsed[area.glimpsed[:, 3] >= key - config.end_patience]
    uid = area.features.uid[walls]
    same = (old[:, 0] == uid[:, None]) & (old[:, 1] == sides[:, None])
    same &= np.abs(old[:, 2] - x[:, None]) < 4.0 * sigma[:, None]
    again = same.any(axis=1)
    first = np.column_stack((uid, sides, x, np.full(len(x), float(key))))[~again]
    return again, np.concatenate((old[~same.any(axis=0)], first))


def forget_unseen(area: AreaMap, key: int, config: ForgetConfig) -> tuple[AreaMap, int]:
    """Forget what has not been seen for long, against how often it ever was.

    An object seen n times is kept for `patience * n` key scans, and for good after `enough`
    sightings. Ends go with their wall. Returns how many were forgotten.
    """
    f = area.features
    unseen = key - f.last
    drop = (f.kind != ANCHOR) & (f.seen < config.enough) & (unseen > config.patience * f.seen)
    gone = f.uid[drop & (f.kind == WALL)]
    drop |= (f.kind == END) & np.isin(f.wall, gone)
    if not drop.any():
        return area, 0
    return forget(area, drop), int(drop.sum())
