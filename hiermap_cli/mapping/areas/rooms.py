"""Rooms and corridors: which of the filter's areas are one, and which portals are doors.

The filter begins an area wherever a door may be, and asks later. At the end of the log all that
was seen is there: every door candidate has the evidence of all its crossings, it is known where
the robot came round it another way, and how large the areas are that it would part. Candidates
that do not hold are refused, with the reason, and the areas on both sides are one. Doors found
twice, in two areas that proved to be one, are one door.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.areas.common_ground import Bars, Open, grounds, one_place, together
from hiermap_cli.mapping.portals import door_frame
from hiermap_cli.mapping.topology.door_evidence import demanded

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import AreaConfig, DoorConfig
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.areas.common_ground import Ground
    from hiermap_cli.mapping.portals import Portal
    from hiermap_cli.mapping.topology.places import Places

    Array = NDArray[np.float64]

SAME_DOOR = 0.7  # metres between two sightings of one door
STRAY = 1.5  # metres from a door to the path in an area that it is no door of
SAME_HEADING = 0.7  # radians (of the line, not of the direction) between them


class Refused(NamedTuple):
    """A door candidate that is none: the portal's index, and why."""

    portal: int
    reason: str


class Rooms(NamedTuple):
    """The areas that people see.

    parts: the filter's areas of each, the first entered first, in the order of the first.
    portals: the portals with their final kinds: "door" once for every door, with all its
    crossings; refused ones are "same". door: for each portal, the portal that stands for its
    door, or None. refused: the candidates that are no doors. bars: the doors in g. paths: of each
    of the filter's areas the cells (k, 2) of its path that lie in the area to which it belongs,
    where that is known better than by the filter.
    """

    parts: tuple[tuple[int, ...], ...]
    portals: tuple[Portal, ...]
    door: tuple[int | None, ...]
    refused: tuple[Refused, ...]
    bars: Bars = Bars(np.zeros((0, 3)), np.zeros(0))
    paths: tuple[Array, ...] | None = None


def decide(
    areas: Sequence[AreaMap],
    portals: Sequence[Portal],
    places: Places,
    frames: Array,
    doors: DoorConfig,
    config: AreaConfig,
    *,
    placed: bool = False,
) -> Rooms:
    """Which areas are one and which portals are doors. frames: (K, 3) of the areas in g.

    placed: the areas lie in g so well that what they have seen of the same ground is the same.
    """
    in_g = np.array(
        [se2.compose(frames[p.a], door_frame(areas[p.a], p, from_a=True)) for p in portals]
    ).reshape(-1, 3)
    case = _Case(portals, in_g, list(range(len(areas))))
    for p in portals:
        if p.kind in ("same", "size"):
            case.join(p.a, p.b)
    case.refuse_rounded()
    for members in case.doors():
        if case.evidence(members) < demanded(portals[members[0]].width, doors):
            case.refuse(members, "too little wall beside it, over all crossings")
    if placed:
        _join_by_ground(case, places, frames, config, doors.max_width)
        size = _size_by_ground(case, places, frames, config)
    else:
        size = _size_by_parts(case, areas, places, config)
    while (small := case.too_small(size, config.min_area)) is not None:
        beside = [m for m in case.doors() if small in case.ends(m[0])]
        case.refuse(min(beside, key=case.evidence), "the area behind it is too small")
    if not placed:
        return case.closed()
    ground = grounds(places, frames, case.bars(), config.opening)
    case.find_strays(ground, frames)
    return case.closed()._replace(paths=tuple(one.way for one in ground))


def _join_by_ground(
    case: _Case, places: Places, frames: Array, config: AreaConfig, widest_door: float
) -> None:
    """Join areas that have seen the same ground; the doors are those not yet refused.

    A door that does not part the ground of the two areas that it joins is none; and one that is
    refused leaves others more in common.
    """
    driven = [p for p in case.portals if p.kind in ("door", "same", "size")]
    across = {(min(p.a, p.b), max(p.a, p.b)) for p in driven}
    ways = -1
    while ways != len(case.candidates):
        ways = len(case.candidates)
        ground = grounds(places, frames, case.bars(), config.opening)
        sure = grounds(places, frames, case.bars(), widest_door)
        is_open = Open(places, frames, case.bars(), widest_door)
        for a, b in one_place(ground, sure, across, config.one_place, is_open):
            case.join(a, b)
        case.refuse_rounded()


def _size_by_ground(
    case: _Case, places: Places, frames: Array, config: AreaConfig
) -> Callable[[Sequence[int]], float]:
    ground = grounds(places, frames, case.bars(), 0.5 * config.opening)
    return lambda parts: together([ground[i] for i in parts])


def _size_by_parts(
    case: _Case, areas: Sequence[AreaMap], places: Places, config: AreaConfig
) -> Callable[[Sequence[int]], float]:
    opening = 0.5 * config.opening
    sizes = [places.size(i, area, case.portals, opening) for i, area in enumerate(areas)]
    return lambda parts: sum(sizes[i] for i in parts)


class _Case:
    """What is still open: door candidates, and areas by the group that they belong to.

    A group is named by its first area.
    """

    def __init__(self, portals: Sequence[Portal], in_g: Array, group: list[int]) -> None:
        self.portals = portals
        self.in_g = in_g
        self.group = group
        self.candidates = [i for i, p in enumerate(portals) if p.kind == "door"]
        self.refused: list[Refused] = []
        self.strays: set[int] = set()

    def join(self, a: int, b: int) -> None:
        """Two areas are one."""
        first, second = sorted((self.group[a], self.group[b]))
        self.group = [first if g == second else g for g in self.group]

    def refuse(self, members: Sequence[int], reason: str) -> None:
        """These candidates are no doors: the areas that they join are one."""
        for i in members:
            self.refused.append(Refused(i, reason))
            self.candidates.remove(i)
            self.join(self.portals[i].a, self.portals[i].b)

    def refuse_rounded(self) -> None:
        """Refuse candidates within one area."""
        for i in list(self.candidates):
            if len(self.ends(i)) == 1:
                self.refuse([i], "the robot came round it another way")

    def bars(self) -> Bars:
        """The candidates in g."""
        which = self.candidates
        return Bars(self.in_g[which], np.array([self.portals[i].width for i in which]))

    def ends(self, i: int) -> set[int]:
        """The areas on both sides of a candidate."""
        return {self.group[self.portals[i].a], self.group[self.portals[i].b]}

    def find_strays(self, ground: Sequence[Ground], frames: Array) -> None:
        """Candidates that do not lie where one of their areas is.

        The robot had left the area before, by a door that it did not notice.
        """
        for i in self.candidates:
            for area in (self.portals[i].a, self.portals[i].b):
                door = se2.between(frames[area], self.in_g[i])[:2]
                apart = np.hypot(*(ground[area].way - door).T).min(initial=np.inf)
                if apart > STRAY:
                    self.strays.add(i)

    def doors(self) -> list[list[int]]:
        """Candidates by doors: of one door are those between the same areas, in one place.

        A stray is a door that is there already, whatever areas it is said to lie between.
        """
        sets: list[list[int]] = []
        for i in sorted(self.candidates, key=lambda i: (i in self.strays, i)):
            for members in sets:
                d = self.in_g[i] - self.in_g[members[0]]
                near = np.hypot(d[0], d[1]) < SAME_DOOR
                alike = abs(np.sin(d[2])) < np.sin(SAME_HEADING)
                same = i in self.strays or self.ends(i) == self.ends(members[0])
                if near and alike and same:
                    members.append(i)
                    break
            else:
                sets.append([i])
        return sets

    def evidence(self, members: Sequence[int]) -> float:
        """Metres of wall less openings beside a door, the mean over all its crossings."""
        crossings = np.array([self.portals[i].crossings for i in members])
        net = np.array([self.portals[i].wall - self.portals[i].open for i in members])
        return float(crossings @ net / crossings.sum())

    def too_small(self, size: Callable[[Sequence[int]], float], least: float) -> int | None:
        """The smallest area that is too small to be one and has a door to give up.

        size: square metres of some of the filter's areas together.
        """
        total = {
            g: size([part for part, own in enumerate(self.group) if own == g])
            for g in set(self.group)
        }
        beside = {g for i in self.candidates for g in self.ends(i)}
        small = [g for g in beside if total[g] < least]
        return min(small, key=lambda g: (total[g], g), default=None)

    def closed(self) -> Rooms:
        """What is decided."""
        final = list(self.portals)
        door: list[int | None] = [None] * len(final)
        for i, _ in self.refused:
            final[i] = replace(final[i], kind="same")
        for members in self.doors():
            best = max(members, key=lambda i: (i not in self.strays, self.evidence([i]), -i))
            crossings = sum(self.portals[i].crossings for i in members)
            for i in members:
                door[i] = best
                final[i] = replace(final[i], kind="open")
            final[best] = replace(self.portals[best], crossings=crossings)
        names = sorted(set(self.group))
        parts = tuple(tuple(i for i, g in enumerate(self.group) if g == name) for name in names)
        return Rooms(parts, tuple(final), tuple(door), tuple(self.refused), self.bars())
