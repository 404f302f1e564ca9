"""From area to area: through a known door, through a new one, or out of one grown too large."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.stochastic_map import initial_map, place_robot, relative_covariance
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import EMPTY, AreaMap
from hiermap_cli.mapping.model import Event
from hiermap_cli.mapping.portals import Pinch, PinchDetector, add_anchor, wall_evidence

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.mapping.trail import Trail

    Array = NDArray[np.float64]


@dataclass(slots=True)
class Portal:
    """A door between two areas: an anchor in each, and where the door lies from it.

    R_anchor_d: (3,) the door's frame from the anchor: origin midway between the jambs, X along
    them, Y from area `a` to area `b`.
    """

    a: int
    anchor_a: int
    b: int
    anchor_b: int
    R_anchor_d: Array
    width: float
    wall: float
    crossings: int = 1


class Passing(NamedTuple):
    """What a key scan tells about where the robot passes.

    Its stamp and number, metres of path since the last one, clearance to the left and right.
    """

    stamp_ns: int
    key: int
    distance: float
    left: float
    right: float


@dataclass(slots=True)
class Crossings:
    """Watches for doors, and opens and re-enters areas.

    `areas`, `trail` and `events` are the mapper's own: areas are replaced and appended here.
    """

    config: Config
    areas: list[AreaMap]
    trail: Trail
    events: list[Event]
    portals: list[Portal] = field(default_factory=list)
    current: int = 0
    _pinches: PinchDetector = field(init=False)

    def __post_init__(self) -> None:
        self._pinches = PinchDetector(self.config.doors)

    @property
    def area(self) -> AreaMap:
        """The area in which the robot is."""
        return self.areas[self.current]

    def step(self, current: int, now: Passing) -> int:
        """After a key scan in area `current`: the area in which the robot is from now on."""
        self.current = current
        self._cross(now)
        return self.current

    def _cross(self, now: Passing) -> None:
        """Through a known door, through a new one, or out of an area that has grown too large."""
        through = self._known_portal()
        if through is not None:
            self._reenter(now.stamp_ns, through)
            return
        pinch = self._pinches.passed(self.area.V.robot, now.distance, now.left, now.right)
        if pinch is not None and not self._near_portal(pinch.frame):
            wall = wall_evidence(self.area, pinch, self.config.doors)
            if wall >= self.config.doors.min_wall:
                self._enter_new(now, pinch, wall)
                return
            self._event(
                now.stamp_ns, "pinch_passed", area=self._name(), width=pinch.width, wall=wall
            )
        c = self.config.areas
        far = np.hypot(*self.area.V.robot[:2]) > c.max_extent
        if far or len(self.area.features.uid) > c.max_objects:
            frame = se2.compose(self.area.V.robot, np.array([0.0, 0.0, -0.5 * np.pi]))
            self._enter_new(now, Pinch(frame, 2.0, 0.0), 0.0)

    def _door_frames(self) -> list[tuple[int, bool, Array]]:
        """Doors of the current area: (portal, whether this is its side a, R_A_d)."""
        out = []
        for i, p in enumerate(self.portals):
            for side, anchor in ((p.a, p.anchor_a), (p.b, p.anchor_b)):
                if side == self.current:
                    pose = self._anchor(side, anchor)
                    out.append((i, side == p.a, se2.compose(pose, p.R_anchor_d)))
        return out

    def _anchor(self, area: int, uid: int) -> Array:
        pose: Array = self.areas[area].V.poses[1 + self._anchor_index(area, uid)]
        return pose

    def _anchor_index(self, area: int, uid: int) -> int:
        return int(np.flatnonzero(self.areas[area].features.uid == uid)[0])

    def _near_portal(self, frame: Array) -> bool:
        return any(np.hypot(*(R_A_d[:2] - frame[:2])) < 0.8 for _, _, R_A_d in self._door_frames())

    def _known_portal(self) -> int | None:
        """The door that the robot has gone through since the last key scans, if it has."""
        hysteresis = self.config.doors.hysteresis
        for i, from_a, R_A_d in self._door_frames():
            u, v, _ = se2.between(R_A_d, self.area.V.robot)
            beyond = v if from_a else -v
            half = 0.5 * self.portals[i].width + 0.3
            if hysteresis < beyond < hysteresis + 0.6 and abs(u) < half + beyond:
                before = self.trail.recent(self.current, 1.5)
                if before is None:
                    continue
                w = se2.between(R_A_d, before)
                side = w[:, 1] if from_a else -w[:, 1]
                crossing = np.flatnonzero((side[:-1] <= 0.0) & (side[1:] > 0.0))
                if len(crossing) and abs(w[crossing[-1], 0]) < half:
                    return i
        return None

    def _enter_new(self, now: Passing, pinch: Pinch, wall: float) -> None:
        """A new area, with its frame where the robot is: certain in its own frame."""
        a = self.current
        area, anchor_a = add_anchor(self.area, now.key)
        self.areas[a] = area
        V = area.V
        m = len(V.parameters)
        new = AreaMap(
            initial_map(
                np.zeros(3),
                np.zeros((3, 3)),
                V.parameters,
                V.covariance[3 : 3 + m, 3 : 3 + m],
                V.coordinates,
            ),
            EMPTY,
        )
        new, anchor_b = add_anchor(new, now.key)
        self.areas.append(new)
        self.current = len(self.areas) - 1
        R_anchor_d = se2.between(V.robot, pinch.frame)
        self.portals.append(
            Portal(a, anchor_a, self.current, anchor_b, R_anchor_d, pinch.width, wall)
        )
        self._pinches = PinchDetector(self.config.doors)
        self._event(
            now.stamp_ns, "area_entered", area=self._name(), door=f"D{len(self.portals)}",
            width=pinch.width, wall=wall,
        )  # fmt: skip

    def _reenter(self, stamp_ns: int, index: int) -> None:
        """Back through a known door: the robot is placed in the old area by the door's anchors.

        The door seen from here is the door seen from there; what the robot did since it was
        there is in the area that it leaves, and independent of the one it enters.
        """
        p = self.portals[index]
        here, there = (p.a, p.b) if p.a == self.current else (p.b, p.a)
        out, into = (p.anchor_a, p.anchor_b) if here == p.a else (p.anchor_b, p.anchor_a)
        V = self.area.V
        i = 1 + self._anchor_index(here, out)
        R_anchor_r = se2.between(V.poses[i], V.robot)
        C = relative_covariance(V, i, 0)
        m = len(V.parameters)
        other = self.areas[there]
        j = 1 + self._anchor_index(there, into)
        V = place_robot(other.V, j, R_anchor_r, C, V.parameters, V.covariance[3 : 3 + m, 3 : 3 + m])
        self.current = there
        self.areas[there] = replace(other, V=V)
        p.crossings += 1
        self._pinches = PinchDetector(self.config.doors)
        self._event(stamp_ns, "area_reentered", area=self._name(), door=f"D{index + 1}")

    def _name(self) -> str:
        return f"A{self.current + 1}"

    def _event(self, stamp_ns: int, kind: str, **details: object) -> None:
        self.events.append(Event(stamp_ns, kind, details))
