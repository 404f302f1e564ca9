"""A robot that is not where it is believed to be: noticed, and found again anywhere.

Carried elsewhere, or after a slip farther than is searched, the scans fit nothing about the
believed place, and what is more they look through walls that are known to stand there; ground
that is merely new shows neither. After some such scans in a row the robot is *lost*. What was
taken in since then is taken back, the map is as it was before, and a new area begins that hangs
on nothing: a fragment. Its walls are laid on those of all other areas, wherever that may be, and
when one place is found twice, with some path in between and well ahead of every other place, the
fragment is joined there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.geometry.median import median
from hiermap_cli.mapping.association.recognition import Recognised, lately_seen, walls_explained
from hiermap_cli.mapping.association.relocation import area_lines, explained_length
from hiermap_cli.mapping.topology.whereabouts import Seen, compared, seen_lately, settled

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.association.relocation import Lines
    from hiermap_cli.mapping.topology.trace import Trace
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

LIKELY = 0.7  # of what a place must explain, before it is laid on the walls exactly
APART, APART_ANGLE = 0.8, 0.25  # metres and radians between places that are two
MAX_WALLS, SCORED = 10, 100  # walls that hypotheses are made of; hypotheses that are scored
CELL, CELL_ANGLE = 0.25, 0.1  # metres and radians within which hypotheses are one


def through_walls(area: AreaMap, origins: Array, ends: Array, config: Config) -> float:
    """The share of beams from `origins` (n, 2) or (2,) to `ends` (n, 2) that go through walls."""
    lines = area_lines(area, config.relocation.least_seen)
    if not len(lines.theta) or not len(ends):
        return 0.0
    normal, deep = lines.normal, config.lost.behind
    origins = np.broadcast_to(origins, ends.shape)
    before, after = origins @ normal.T - lines.offset, ends @ normal.T - lines.offset
    passes = (before * after < 0.0) & (np.abs(after) > deep) & (np.abs(before) > 1e-6)
    direction = np.column_stack((normal[:, 1], -normal[:, 0]))
    share = before / np.where(passes, before - after, 1.0)
    along = (1.0 - share) * (origins @ direction.T) + share * (ends @ direction.T)
    passes &= (along > lines.lo) & (along < lines.hi)
    return float(np.count_nonzero(passes.any(axis=1)) / len(ends))


class Place(NamedTuple):
    """An area in which a lost robot may be.

    area: its map. frame: (3,) where it lies, as far as that is known, to tell one place in two
    areas from two places. seen: what was seen of it.
    """

    area: AreaMap
    frame: Array
    seen: Seen


@dataclass(slots=True)
class Search:
    """Lays what was mapped lately on the walls of all areas, wherever they are."""

    config: Config
    _before: tuple[float, Recognised] | None = None

    def forget(self) -> None:
        """The robot is found, or lost anew."""
        self._before = None

    def ask(
        self, here: AreaMap, key: int, trace: Trace, places: Mapping[int, Place]
    ) -> Recognised | None:
        """The area, and place in it, that is found for the second time, if one is."""
        c = self.config
        view, middle = lately_seen(here, key, c.areas)
        if len(view.length) < c.areas.least_walls:
            return None
        R_c_v = np.array([*middle, 0.0])
        found = self._best(view, se2.invert(R_c_v), seen_lately(trace), places)
        if found is None:
            self._before = None
            return None
        number, pose, explained = found
        walls = walls_explained(places[number].area, view, pose, c)
        if walls < c.areas.least_walls:
            self._before = None
            return None
        R_h_c = se2.compose(pose, se2.invert(R_c_v))
        total = float(view.length.sum())
        return self._second(Recognised(number, R_h_c, explained, total, walls), here, trace)

    def _second(self, found: Recognised, here: AreaMap, trace: Trace) -> Recognised | None:
        """The answer, if it is the same as the one before, with path enough in between."""
        c, robot = self.config.areas, here.V.robot
        if self._before is not None and self._before[1].area == found.area:
            travelled, before = self._before
            off = se2.between(se2.compose(before.R_h_c, robot), se2.compose(found.R_h_c, robot))
            if np.hypot(off[0], off[1]) < 2.0 * c.agree and abs(off[2]) < 2.0 * c.agree_angle:
                return found if trace.length - travelled >= c.agree_path_old else None
        self._before = (trace.length, found)
        return None

    def _best(
        self, view: SegmentView, R_v_c: Array, seen: Seen, places: Mapping[int, Place]
    ) -> tuple[int, Array, float] | None:
        """Area, pose (3,) of the view in it, and metres explained, if all else is contradicted.

        R_v_c: the present area's frame in the view's; seen: what was seen lately, in that area.
        """
        c = self.config
        enough = max(c.lost.min_explained, c.lost.min_share * float(view.length.sum()))
        number: list[int] = []
        poses, score = [np.zeros((0, 3))], [np.zeros(0)]
        for h, place in places.items():
            lines = area_lines(place.area, c.relocation.least_seen)
            tried = constellations(lines, view)
            if len(tried):
                explained = explained_length(lines, view, tried, c.relocation)
                tried = tried[explained >= LIKELY * enough]
            if len(tried):
                tried = settled(lines, view, tried, c.relocation)
                number += [h] * len(tried)
                poses.append(tried)
                score.append(explained_length(lines, view, tried, c.relocation))
        if not number:
            return None
        area_of, all_poses = np.array(number, dtype=np.int64), np.concatenate(poses)
        explained = np.concatenate(score)
        share, against = np.zeros(len(number)), np.ones(len(number))
        for h in dict.fromkeys(number):
            of = area_of == h
            share[of], against[of] = compared(
                seen, places[h].seen, se2.compose(all_poses[of], R_v_c)
            )
        known = (share > c.lost.min_seen) & (explained >= enough)
        if not known.any():
            return None
        best = int(np.argmin(np.where(known, against, np.inf)))
        frames = np.array([places[h].frame for h in number])
        at = se2.compose(frames, all_poses)
        apart = np.hypot(*(at[:, :2] - at[best, :2]).T) > APART
        apart |= np.abs(se2.wrap(at[:, 2] - at[best, 2])) > APART_ANGLE
        rivals = apart & (share > 0.5 * c.lost.min_seen)
        second = float(against[rivals].min()) if rivals.any() else 1.0
        if against[best] > c.lost.max_against or second < c.lost.clear * max(
            against[best], c.lost.floor
        ):
            return None
        # Of areas from which the place was seen, the one to which it belongs has seen most of it.
        here = known & ~apart & (against <= c.lost.max_against)
        best = int(np.argmax(np.where(here, share, -1.0)))
        return int(area_of[best]), all_poses[best], float(explained[best])


def constellations(lines: Lines, view: SegmentView) -> Array:
    """Poses (h, 3) that lay two walls of the view, which are not parallel, on two of the lines.

    One pose a cell, those that most metres of wall ask for.
    """
    longest = np.argsort(-view.length, kind="stable")[:MAX_WALLS]
    s, w = (a.ravel() for a in np.meshgrid(longest, np.arange(len(lines.theta)), indexing="ij"))
    fits = view.length[s] < 1.3 * (lines.hi - lines.lo)[w] + 0.3
    s, w = s[fits], w[fits]
    theta = se2.wrap(lines.theta[w] - view.theta[s])
    i, j = np.triu_indices(len(s), 1)
    normal = lines.normal[w]
    cross = normal[i, 0] * normal[j, 1] - normal[i, 1] * normal[j, 0]
    ok = (s[i] != s[j]) & (np.abs(cross) > 0.5)
    i, j, cross = i[ok], j[ok], cross[ok]
    step = se2.wrap(theta[j] - theta[i])
    ok = np.abs(step) < 0.06
    i, j, cross = i[ok], j[ok], cross[ok]
    heading = theta[i] + 0.5 * step[ok]
    c, si = np.cos(heading), np.sin(heading)

    def rest(k: Index) -> Array:
        """How far the middle of a wall of the view must move to lie on its line."""
        m = view.centre[s[k]]
        x, y = c * m[:, 0] - si * m[:, 1], si * m[:, 0] + c * m[:, 1]
        return np.asarray(lines.offset[w[k]] - normal[k, 0] * x - normal[k, 1] * y)

    a, b = rest(i), rest(j)
    x = (a * normal[j, 1] - b * normal[i, 1]) / cross
    y = (normal[i, 0] * b - normal[j, 0] * a) / cross
    poses = np.column_stack((x, y, se2.wrap(heading)))
    if not len(poses):
        return poses
    votes = np.minimum(view.length[s[i]], view.length[s[j]])
    cells = np.floor(poses / np.array([CELL, CELL, CELL_ANGLE])).astype(np.int64)
    _, first, at = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    total = np.bincount(at.ravel(), votes)
    order = np.lexsort((first, -total))[:SCORED]
    best = poses[first[order]].copy()
    for k, cell in enumerate(order.tolist()):
        best[k, :2] = median(poses[at.ravel() == cell, :2])
    return best


def moved(R: Array, points: Array) -> Array:
    """Points (n, 2) seen through R (3,)."""
    c, s = np.cos(R[2]), np.sin(R[2])
    return np.asarray(R[:2] + points @ np.array([[c, s], [-s, c]]))
