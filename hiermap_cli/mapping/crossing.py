"""From area to area: through a known door, through a new one, or out of one grown too large."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.stochastic_map import place_robot, relative_covariance
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import area_from_here
from hiermap_cli.mapping.model import Event
from hiermap_cli.mapping.passages import Passage, PassageDetector, Trace
from hiermap_cli.mapping.portals import KnownDoors, Portal, add_anchor, anchor_index

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.portals import PortalKind
    from hiermap_cli.perception.sight import Sight
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]


class Passing(NamedTuple):
    """A key scan after the filter has used it: its stamp and number, metres of path since the
    last one, and what it saw."""

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
    _detector: PassageDetector = field(init=False)
    _doors: KnownDoors = field(init=False)

    def __post_init__(self) -> None:
        self._detector = PassageDetector(self.config.doors)
        self._doors = KnownDoors(self.config.doors.hysteresis)

    @property
    def area(self) -> AreaMap:
        """The area in which the robot is."""
        return self.areas[self.current]

    def step(self, now: Passing) -> int:
        """After a key scan: the area in which the robot is from now on."""
        self.trace.add(self.area.V.robot, now.distance, now.sight)
        through = self._doors.gone_through(self.area.V.robot)
        if through is not None:
            self._reenter(now, through)
            return self.current
        passage = self._detector.passed(self.trace)
        if passage is not None and not self._doors.near(passage.frame):
            if passage.evidence >= self.config.doors.min_evidence:
                self._enter_new(now, "door", passage)
                return self.current
            self._event(now, "door_refused", area=self._name(), **_figures(passage))
        c = self.config.areas
        far = np.hypot(*self.area.V.robot[:2]) > c.max_extent
        if far or len(self.area.features.uid) > c.max_objects:
            frame = se2.compose(self.area.V.robot, np.array([0.0, 0.0, -0.5 * np.pi]))
            at = Passage(frame, 2.0, self.trace.length, np.zeros(2), np.zeros(2))
            self._enter_new(now, "size", at)
        return self.current

    def _enter_new(self, now: Passing, kind: PortalKind, passage: Passage) -> None:
        """A new area, with its frame where the robot is: certain in its own frame."""
        a = self.current
        left, anchor_a = add_anchor(self.area, now.key)
        self.areas[a] = left
        V = left.V
        new, anchor_b = add_anchor(area_from_here(self.area, now.key), now.key)
        self.areas.append(new)
        b = len(self.areas) - 1
        self.portals.append(
            Portal(
                a, anchor_a, b, anchor_b, kind, se2.between(V.robot, passage.frame), passage.width,
                float(passage.wall.sum()), float(passage.open.sum()),
            )  # fmt: skip
        )
        self._go(b, V.robot)
        self._event(
            now, "area_entered", area=self._name(), door=f"D{len(self.portals)}",
            **_figures(passage),
        )  # fmt: skip

    def _reenter(self, now: Passing, index: int) -> None:
        """Back through a known door: the robot is placed in the old area by the door's anchors.

        The door seen from here is the door seen from there; what the robot did since it was
        there is in the area that it leaves, and independent of the one it enters.
        """
        p = self.portals[index]
        out_of_a = p.a == self.current
        there = p.b if out_of_a else p.a
        out, into = (p.anchor_a, p.anchor_b) if out_of_a else (p.anchor_b, p.anchor_a)
        V = self.area.V
        i = anchor_index(self.area, out)
        R_anchor_r = se2.between(V.poses[i], V.robot)
        C = relative_covariance(V, i, 0)
        m = len(V.parameters)
        other = self.areas[there]
        placed = place_robot(
            other.V, anchor_index(other, into), R_anchor_r, C,
            V.parameters, V.covariance[3 : 3 + m, 3 : 3 + m],
        )  # fmt: skip
        self.areas[there] = replace(other, V=placed)
        self.portals[index] = replace(p, crossings=p.crossings + 1)
        self._go(there, V.robot)
        self._event(now, "area_reentered", area=self._name(), door=f"D{index + 1}")

    def _go(self, area: int, R_here_r: Array) -> None:
        """On in another area, where the robot is placed; in the one left it was at `R_here_r`."""
        self.current = area
        R_there_here = se2.compose(self.area.V.robot, se2.invert(R_here_r))
        self.trace.move(R_there_here)
        self._detector.move(R_there_here)
        self._detector.forget_before(self.trace.length)
        self._doors.set(area, self.areas, self.portals)

    def _name(self) -> str:
        return f"A{self.current + 1}"

    def _event(self, now: Passing, kind: str, **details: object) -> None:
        self.events.append(Event(now.stamp_ns, kind, details))


def _figures(passage: Passage) -> dict[str, object]:
    return {
        "width": passage.width,
        "wall": passage.wall.tolist(),
        "open": passage.open.tolist(),
    }
