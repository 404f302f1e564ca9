"""The mapper: a log's scans in, the three levels and the trajectory out."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.estimation import motion as odometry_model
from hiermap_cli.estimation.stochastic_map import (
    initial_map,
    place_robot,
    predict,
    relative_covariance,
)
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_filter import Step, forget_unseen, observe
from hiermap_cli.mapping.area_map import EMPTY, AreaMap
from hiermap_cli.mapping.model import Event
from hiermap_cli.mapping.portals import Pinch, PinchDetector, add_anchor, wall_evidence
from hiermap_cli.mapping.relocation import relocate, robot_found
from hiermap_cli.mapping.trail import Trail
from hiermap_cli.perception.clearance import clearance
from hiermap_cli.perception.segmentation import segment_block
from hiermap_cli.perception.views import scan_views

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.logs.records import ScanBlock
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]

FORGET_EVERY = 10


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


@dataclass(slots=True)
class Counts:
    """What the run's metrics are made of."""

    keys: int = 0
    offered: int = 0
    matched: int = 0
    failed: int = 0
    forgotten: int = 0
    nis: float = 0.0
    degrees: int = 0


@dataclass(slots=True)
class Mapper:
    """Runs the filters over scans in the order of time. One for each log."""

    config: Config
    areas: list[AreaMap] = field(default_factory=list)
    portals: list[Portal] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    trail: Trail = field(default_factory=Trail)
    current: int = 0
    key: int = 0
    _odometry: Array | None = None
    _pinches: PinchDetector | None = None

    def take(self, block: ScanBlock) -> None:
        """Segment a block of scans and filter them one by one."""
        segments = segment_block(block, self.config.laser, self.config.segmentation)
        room = clearance(block)
        views = scan_views(segments, len(block), self.config.filter)
        for i, view in enumerate(views):
            self._scan(
                int(block.stamps_ns[i]),
                block.odometry[i],
                view,
                float(room.left[i]),
                float(room.right[i]),
            )

    def _scan(self, stamp_ns: int, odometry: Array, view: SegmentView, left: float, right: float) -> None:
        if self._odometry is None:
            self._begin(stamp_ns, odometry)
            self._observe(stamp_ns, view)
            self.trail.key(stamp_ns, self.current, self.area.V)
            return
        increment = se2.between(self._odometry, odometry)
        distance = float(np.hypot(increment[0], increment[1]))
        c = self.config.filter
        if distance < c.key_distance and abs(increment[2]) < c.key_angle:
            self.trail.between(stamp_ns, increment)
            return
        V = self.area.V
        motion = odometry_model.motion(increment, V.parameters, self.config.odometry)
        suspect = self._implausible(stamp_ns, increment)
        if suspect:
            motion = odometry_model.distrusted(motion, self.config.odometry)
        self._set(replace(self.area, V=predict(V, motion)))
        self._odometry = odometry
        self._observe(stamp_ns, view, suspect=suspect)
        self.trail.key(stamp_ns, self.current, self.area.V)
        self._cross(stamp_ns, distance, left, right)

    @property
    def area(self) -> AreaMap:
        """The area in which the robot is."""
        return self.areas[self.current]

    def _set(self, area: AreaMap) -> None:
        self.areas[self.current] = area

    def _begin(self, stamp_ns: int, odometry: Array) -> None:
        c = self.config
        V = initial_map(
            np.zeros(3),
            np.zeros((3, 3)),
            np.zeros(odometry_model.PARAMETERS),
            odometry_model.prior_covariance(c.odometry),
            c.coordinates,
        )
        self.areas.append(AreaMap(V, EMPTY))
        self._pinches = PinchDetector(c.doors)
        self._odometry = odometry
        self._event(stamp_ns, "area_entered", area="A1")

    def _implausible(self, stamp_ns: int, increment: Array) -> bool:
        """Whether no robot of this kind moves so: the odometry has failed since the last scan."""
        c = self.config.relocation
        seconds = max(stamp_ns - self.trail.last_stamp_ns(), 1) * 1e-9
        if np.hypot(increment[0], increment[1]) < max(c.max_speed * seconds, 0.3) and abs(
            increment[2]
        ) < max(c.max_turn_rate * seconds, 0.3):
            return False
        self._event(stamp_ns, "odometry_failed", area=self._name(), increment=increment.tolist())
        return True

    def _observe(self, stamp_ns: int, view: SegmentView, *, suspect: bool = False) -> None:
        step: Step = observe(self.area, view, self.key, self.config)
        if suspect or self._poor(view, step):
            found = relocate(
                self.area, view, self.config.relocation,
                self.config.relocation.max_distance, self.config.relocation.max_turn,
            )  # fmt: skip
            if found is not None:
                V = robot_found(self.area.V, found.pose, self.config.relocation)
                again = observe(replace(self.area, V=V), view, self.key, self.config)
                if _matched_length(view, again) > _matched_length(view, step):
                    moved = se2.between(step.area.V.robot, again.area.V.robot)
                    step = again
                    self._event(stamp_ns, "relocated", area=self._name(), moved=moved.tolist())
        self._set(step.area)
        n = self.counts
        n.keys += 1
        n.offered += step.offered
        n.matched += len(step.matches.wall)
        n.nis += step.nis
        n.degrees += step.degrees
        if step.offered and not len(step.matches.wall):
            n.failed += 1
            self._event(stamp_ns, "matching_failed", area=self._name(), segments=step.offered)
        self.key += 1
        if self.key % FORGET_EVERY == 0:
            area, forgotten = forget_unseen(self.area, self.key, self.config.forget)
            n.forgotten += forgotten
            self._set(area)

    def _poor(self, view: SegmentView, step: Step) -> bool:
        total = float(view.length.sum())
        return (
            len(view.length) >= 3
            and len(self.area.features.uid) > 3
            and _matched_length(view, step) < self.config.relocation.poor_match * total
        )

    def _cross(self, stamp_ns: int, distance: float, left: float, right: float) -> None:
        """Through a known door, through a new one, or out of an area that has grown too large."""
        through = self._known_portal()
        if through is not None:
            self._reenter(stamp_ns, through)
            return
        assert self._pinches is not None
        pinch = self._pinches.passed(self.area.V.robot, distance, left, right)
        if pinch is not None and not self._near_portal(pinch.frame):
            wall = wall_evidence(self.area, pinch, self.config.doors)
            if wall >= self.config.doors.min_wall:
                self._enter_new(stamp_ns, pinch, wall)
                return
            self._event(stamp_ns, "pinch_passed", area=self._name(), width=pinch.width, wall=wall)
        c = self.config.areas
        far = np.hypot(*self.area.V.robot[:2]) > c.max_extent
        if far or len(self.area.features.uid) > c.max_objects:
            frame = se2.compose(self.area.V.robot, np.array([0.0, 0.0, -0.5 * np.pi]))
            self._enter_new(stamp_ns, Pinch(frame, 2.0, 0.0), 0.0)

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
        return self.areas[area].V.poses[1 + self._anchor_index(area, uid)]

    def _anchor_index(self, area: int, uid: int) -> int:
        return int(np.flatnonzero(self.areas[area].features.uid == uid)[0])

    def _near_portal(self, frame: Array) -> bool:
        return any(
            np.hypot(*(R_A_d[:2] - frame[:2])) < 0.8 for _, _, R_A_d in self._door_frames()
        )

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

    def _enter_new(self, stamp_ns: int, pinch: Pinch, wall: float) -> None:
        """A new area, with its frame where the robot is: certain in its own frame."""
        a = self.current
        area, anchor_a = add_anchor(self.area, self.key)
        self._set(area)
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
        new, anchor_b = add_anchor(new, self.key)
        self.areas.append(new)
        self.current = len(self.areas) - 1
        R_anchor_d = se2.between(V.robot, pinch.frame)
        self.portals.append(Portal(a, anchor_a, self.current, anchor_b, R_anchor_d, pinch.width, wall))
        self._pinches = PinchDetector(self.config.doors)
        self._event(
            stamp_ns, "area_entered", area=self._name(), door=f"D{len(self.portals)}",
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
        V = place_robot(
            other.V, j, R_anchor_r, C, V.parameters, V.covariance[3 : 3 + m, 3 : 3 + m]
        )
        self.current = there
        self._set(replace(other, V=V))
        p.crossings += 1
        self._pinches = PinchDetector(self.config.doors)
        self._event(stamp_ns, "area_reentered", area=self._name(), door=f"D{index + 1}")

    def _name(self) -> str:
        return f"A{self.current + 1}"

    def _event(self, stamp_ns: int, kind: str, **details: object) -> None:
        self.events.append(Event(stamp_ns, kind, details))


def _matched_length(view: SegmentView, step: Step) -> float:
    return float(view.length[step.matches.segment].sum())


def run_filter(
    blocks: Iterable[ScanBlock], config: Config, progress: Callable[[int], None] | None = None
) -> tuple[Mapper, dict[str, float]]:
    """The filter over the whole log; returns the mapper and the seconds of each stage."""
    mapper = Mapper(config)
    started = time.process_time()
    for block in blocks:
        mapper.take(block)
        if progress is not None:
            progress(len(block))
    return mapper, {"filter": time.process_time() - started}
