"""From area to area: through a known door, through a new one, or out of one grown too large."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import area_from_here
from hiermap_cli.mapping.association.recognition import Asked, Recogniser
from hiermap_cli.mapping.model import Event
from hiermap_cli.mapping.portals import (
    KnownDoors,
    Portal,
    add_anchor,
    adrift,
    door_frame,
    reached,
)
from hiermap_cli.mapping.topology.again import door_hidden, door_missed, door_of
from hiermap_cli.mapping.topology.door_evidence import longest_reach
from hiermap_cli.mapping.topology.handover import begun_anew, by_anchors, by_walls
from hiermap_cli.mapping.topology.looks import LookRecord
from hiermap_cli.mapping.topology.lost import Place, Search
from hiermap_cli.mapping.topology.passage import Passage
from hiermap_cli.mapping.topology.passages import PassageDetector, crossed_again
from hiermap_cli.mapping.topology.places import AT_HOME, NEAR_BY, Places
from hiermap_cli.mapping.topology.trace import Trace

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.association.recognition import Recognised
    from hiermap_cli.mapping.portals import PortalKind
    from hiermap_cli.mapping.topology.freespace import Region
    from hiermap_cli.perception.sight import Sight
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]

NOWHERE = np.zeros(2)
LATELY = 8.0  # metres of path that are still the same visit


class Passing(NamedTuple):
    """A key scan after the filter has used it.

    Its stamp and number, metres of path since the last one, and what it saw.
    """

    stamp_ns: int
    key: int
    distance: float
    sight: Sight
    view: SegmentView


@dataclass(slots=True)
class Crossings:
    """Watches for doors, and opens and re-enters areas.

    `areas` and `events` are the mapper's own: areas are replaced and appended here.
    """

    config: Config
    areas: list[AreaMap]
    events: list[Event]
    portals: list[Portal] = field(default_factory=list)
    current: int = 0
    trace: Trace = field(default_factory=Trace)
    places: Places = field(init=False)
    _detector: PassageDetector = field(init=False)
    _doors: KnownDoors = field(init=False)
    _recogniser: Recogniser = field(init=False)
    _search: Search = field(init=False)
    _apart: frozenset[int] = frozenset()
    _began: bool = True
    _cut: bool = False

    def __post_init__(self) -> None:
        looks = LookRecord() if self.config.refine.enabled else None
        self.places = Places(self.config.doors.max_width, looks)
        self._detector = PassageDetector(self.config.doors)
        self._doors = KnownDoors(self.config.doors.hysteresis)
        self._recogniser = Recogniser(self.config)
        self._search = Search(self.config)

    @property
    def area(self) -> AreaMap:
        """The area in which the robot is."""
        return self.areas[self.current]

    def step(self, now: Passing) -> int:
        """After a key scan: the area in which the robot is from now on."""
        robot = self.area.V.robot
        self.trace.add(robot, now.distance, now.sight, now.key)
        self.places.look(self.current, self.trace, 2.0 * longest_reach(self.config.doors))
        through = self._doors.gone_through(robot)
        if through is not None:
            self._reenter(now, through)
            return self.current
        passage = self._detector.passed(self.trace)
        if passage is not None and not self._doors.leads_out(passage.frame):
            door = door_of(passage, self._detector, self.trace, self.config.doors)
            if door is not None and not self._doors.leads_out(door.frame):
                self._enter_new(now, "door", door)
                return self.current
            self._event(now, "door_refused", area=self._name(), **passage.figures)
        hidden = door_hidden(self._detector, self.trace, self.config.doors)
        if hidden is not None and not self._doors.leads_out(hidden.frame):
            self._enter_new(now, "door", hidden)
            return self.current
        known = self._recognise(now)
        if known is not None:
            kind = self._link(known)
            missed = door_missed(self.trace, self.config.doors) if kind == "open" else None
            if missed is not None and not self._doors.leads_out(missed.frame):
                self._enter_new(now, "door", missed)
            else:
                self._known_again(now, known, kind)
            return self.current
        c = self.config.areas
        far = math.hypot(robot[0], robot[1]) > c.max_extent
        large = far or len(self.area.features.uid) > c.max_objects
        if large and not self._on_known_ground():
            frame = se2.compose(robot, np.array([0.0, 0.0, -0.5 * np.pi]))
            at = Passage(frame, 2.0, self.trace.length, NOWHERE, NOWHERE)
            self._enter_new(now, "size", at)
        return self.current

    @property
    def lost(self) -> bool:
        """Whether it is not known where the present area lies."""
        return bool(self._apart)

    def set_apart(self, key: int, travelled: float) -> int:
        """A fragment that hangs on nothing: the robot, lost, is certain at its origin.

        It is `key`'s scan that is the fragment's first; what was seen after `travelled` metres of
        path was not seen from where the robot was believed to be. Returns the new area.
        """
        a, c = self.current, self.config.lost
        self.trace.drop(travelled)
        self.places.rewind(key)
        self.places.look(a, self.trace, -1.0)
        left, anchor_a = add_anchor(self.area, key - 1)
        self.areas[a] = left
        V = left.V
        new, anchor_b = adrift(begun_anew(V), key, c.sigma, c.sigma_angle)
        self.areas.append(new)
        b = len(self.areas) - 1
        self.portals.append(Portal(a, anchor_a, b, anchor_b, "lost", np.zeros(3), 0.0, 0.0, 0.0))
        self.trace.drop(-1.0)
        self._go(b, V.robot)
        self._detector.clear(self.trace.length)
        self._search.forget()
        self._began = True
        return b

    def amend(self, poses: Mapping[int, Array]) -> None:
        """The robot has come otherwise: where it was at the last key scans, by their numbers."""
        if poses:
            self._detector.rewind(self.trace.amend(poses))
            since = bisect_left(self.trace.travelled, self.trace.entered)
            self._doors.rewatch(self.trace.poses[since:])

    def finish(self) -> None:
        """The end of the log: what was seen last belongs to the area where the robot is."""
        self.places.look(self.current, self.trace, -1.0)

    def _enter_new(self, now: Passing, kind: PortalKind, passage: Passage) -> None:
        """A new area, with its frame where the robot is: certain in its own frame."""
        a = self.current
        self.places.leave(a, self.trace, passage.frame)
        left, anchor_a = add_anchor(self.area, now.key)
        self.areas[a] = left
        V = left.V
        new, anchor_b = add_anchor(area_from_here(left, now.key), now.key)
        self.areas.append(new)
        b = len(self.areas) - 1
        self.portals.append(
            Portal(
                a,
                anchor_a,
                b,
                anchor_b,
                kind,
                se2.between(V.robot, passage.frame),
                passage.width,
                float(passage.wall.sum()),
                float(passage.open.sum()),
            )
        )
        self._go(b, V.robot)
        self._began, self._cut = True, kind == "size"
        self._event(
            now,
            "area_entered",
            area=self._name(),
            door=f"D{len(self.portals)}",
            **passage.figures,
        )

    def _reenter(self, now: Passing, index: int) -> None:
        """Back through a known door: the robot is placed in the old area by the door's anchors.

        The door seen from here is the door seen from there; what the robot did since it was
        there is in the area that it leaves, and independent of the one it enters.
        """
        p = self.portals[index]
        out_of_a = p.a == self.current
        door = door_frame(self.area, p, from_a=out_of_a)
        self.places.leave(self.current, self.trace, door, 1.0 if out_of_a else -1.0)
        there = p.b if out_of_a else p.a
        out, into = (p.anchor_a, p.anchor_b) if out_of_a else (p.anchor_b, p.anchor_a)
        left = self.area
        self.areas[there] = by_anchors(left, out, self.areas[there], into)
        self.portals[index] = crossed_again(p, door, self.trace)
        self._go(there, left.V.robot)
        self._event(now, "area_reentered", area=self._name(), door=f"D{index + 1}")

    def _recognise(self, now: Passing) -> Recognised | None:
        """An area known before, if the robot has come back into it unawares."""
        if not self._recogniser.due(self.trace.length):
            return None
        if self._apart:
            self._recogniser.asked(self.trace.length)
            return self._search.ask(self.area, now.key, self.trace, self._elsewhere())
        mine = self._same_as(self.current)
        at_home = self._on_known_ground()
        # An area that was cut for its size goes on ahead of the cut.
        before = self.trace.entered - LATELY if self._cut else np.inf
        asked = []
        for h, R_h_r in self._recogniser.candidates(self.area.V.robot):
            # Of one place the area that was begun first is gone on with.
            if (h > self.current) if h in mine else at_home:
                continue
            if not self.places.known_ground(h, R_h_r[:2], before, NEAR_BY):
                continue
            region = self.places.region(h, self.areas[h], self.portals)
            if region.contains(R_h_r[:2]):
                R_h_c = se2.compose(R_h_r, se2.invert(self.area.V.robot))
                asked.append(Asked(h, self.areas[h], self._all_along_in(region, R_h_c)))
        return self._recogniser.ask(self.area, now.key, self.trace.length, asked)

    def _elsewhere(self) -> dict[int, Place]:
        """All areas but those that the robot has been in since it was lost."""
        frames = self._recogniser.frames
        return {
            h: Place(area, frames[h].pose, self.places.seen(h))
            for h, area in enumerate(self.areas)
            if h not in self._apart and h in frames
        }

    def _on_known_ground(self) -> bool:
        """Whether the robot has been about here before, in the present area."""
        before = self.trace.length - LATELY
        return self.places.known_ground(self.current, self.area.V.robot[:2], before, AT_HOME)

    def _all_along_in(self, region: Region, R_h_c: Array) -> bool:
        """Whether the robot has been there ever since it began the present area, just now."""
        return self._began and self.places.within(self.trace, R_h_c, region, self.trace.entered)

    def _same_as(self, area: int) -> set[int]:
        """Areas that are one place with this one."""
        return reached(self.portals, area, ("same",))

    def _link(self, known: Recognised) -> PortalKind:
        """Whether the present area is the same as that which is known again."""
        region = self.places.region(known.area, self.areas[known.area], self.portals)
        young = self._all_along_in(region, known.R_h_c)
        if self._apart and self._began:
            # It has gone through no door since it was lost, if it was mostly where that area is.
            poses = [se2.compose(known.R_h_c, pose) for pose in self.trace.poses]
            inside = [region.contains(pose[:2]) for pose in poses]
            young = 2 * sum(inside) > len(inside)
        return "same" if young else "open"

    def _known_again(self, now: Passing, known: Recognised, kind: PortalKind) -> None:
        """On in an area recognised by its walls, which the robot is now known to be in.

        The robot is placed there as uncertain as such a pose is, and both areas keep it as an
        anchor: a link that no door explains, and a loop of the environment level.
        """
        here, there = self.current, known.area
        self.places.look(here, self.trace, -1.0)
        left, anchor_a = add_anchor(self.area, now.key)
        self.areas[here] = left
        V = left.V
        found = by_walls(V, known.R_h_c, self.areas[there], self.config.relocation)
        self.areas[there], anchor_b = add_anchor(found, now.key)
        link = Portal(here, anchor_a, there, anchor_b, kind, np.zeros(3), 0.0, 0.0, 0.0)
        lost = [i for i, p in enumerate(self.portals) if p.kind == "lost" and p.b in self._apart]
        if lost:
            # It is known now where the fragment lies: not where it was lost.
            self.portals[lost[0]] = replace(
                link, a=there, anchor_a=anchor_b, b=here, anchor_b=anchor_a
            )
        else:
            self.portals.append(link)
        since = int(np.searchsorted(self.trace.travelled, self.trace.entered))
        self._go(there, V.robot, through=False)
        self._doors.replay(self.trace.poses[since:])
        self._event(
            now,
            "area_recognised",
            area=self._name(),
            left=f"A{here + 1}",
            link=kind,
            explained=known.explained,
            total=known.total,
            walls=known.walls,
        )

    def _go(self, area: int, R_here_r: Array, *, through: bool = True) -> None:
        """On in another area, where the robot is placed; in the one left it was at `R_here_r`.

        through: it has gone there by a door just now, which is not told again.
        """
        self.current = area
        R_there_here = se2.compose(self.area.V.robot, se2.invert(R_here_r))
        self.trace.move(R_there_here)
        self._detector.move(R_there_here)
        if through:
            self._detector.forget_before(self.trace.length)
        self._doors.set(area, self.areas, self.portals)
        self._recogniser.set(area, self.areas, self.portals, self.trace.length)
        joined = reached(self.portals, area, ("door", "open", "same", "size"))
        self._apart = frozenset() if 0 in joined else frozenset(joined)
        self.trace.entered = self.trace.length
        self._began = self._cut = False

    def _name(self) -> str:
        return f"A{self.current + 1}"

    def _event(self, now: Passing, kind: str, **details: object) -> None:
        self.events.append(Event(now.stamp_ns, kind, details))
