"""The mapper: a log's scans in, the three levels and the trajectory out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.estimation import motion as odometry_model
from hiermap_cli.estimation.noise import NoiseScale, adapted
from hiermap_cli.estimation.stochastic_map import Motion, initial_map, predict
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import EMPTY, AreaMap
from hiermap_cli.mapping.association.area_filter import Step, forget_unseen, observe
from hiermap_cli.mapping.association.innovations import InnovationLog
from hiermap_cli.mapping.keyscans import BetweenRecord, KeyScanRecord
from hiermap_cli.mapping.model import Event
from hiermap_cli.mapping.odometry.carried import Carried
from hiermap_cli.mapping.odometry.driving import Driving
from hiermap_cli.mapping.odometry.stepping import Stepper, matched_walls
from hiermap_cli.mapping.odometry.stretches import Stretches
from hiermap_cli.mapping.taken import Astray, Counts, Scan
from hiermap_cli.mapping.topology.crossing import Crossings, Passing
from hiermap_cli.mapping.topology.lost import moved, through_walls
from hiermap_cli.mapping.topology.whereabouts import farther_along
from hiermap_cli.mapping.trail import Trail
from hiermap_cli.perception.seen import SeenBlock

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.logs.records import ScanBlock
    from hiermap_cli.mapping.odometry.direction import Branch, Drive
    from hiermap_cli.mapping.portals import Portal

    Array = NDArray[np.float64]

FORGET_EVERY = 10
TOLD_EVERY = 32  # scans after which a progress is told


@dataclass(slots=True)
class Mapper:
    """Runs the filters over scans in the order of time. One for each log."""

    config: Config
    areas: list[AreaMap] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    trail: Trail = field(default_factory=Trail)
    keyscans: KeyScanRecord = field(default_factory=KeyScanRecord)
    between: BetweenRecord = field(default_factory=BetweenRecord)
    innovations: InnovationLog = field(default_factory=InnovationLog)
    current: int = 0
    key: int = 0
    crossings: Crossings = field(init=False)
    noise: NoiseScale = field(default_factory=NoiseScale)
    noise_rate: float = 0.0
    one_area: bool = False  # whether no door is looked for
    stepper: Stepper = field(init=False)
    driving: Driving = field(init=False)
    _begun: bool = False
    _astray: list[Astray] = field(default_factory=list)
    _counted: Counts = field(default_factory=Counts)

    def __post_init__(self) -> None:
        self.crossings = Crossings(self.config, self.areas, self.events)
        self.stepper = Stepper(self.config, self.noise)
        self.driving = Driving(self.stepper, Stretches(self.events))

    def take(
        self,
        block: ScanBlock,
        seen: SeenBlock | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Filter a block of scans one by one; `seen`: what is known of them already.

        progress: told the number of scans worked off, every `TOLD_EVERY` and at the end.
        """
        seen = seen or SeenBlock(block, self.config)
        told = 0
        for i, stamp_ns in enumerate(block.stamps_ns.tolist()):
            self._scan(Scan(stamp_ns, block.odometry[i], block.ranges[i], seen, i))
            if progress is not None and (i + 1 - told == TOLD_EVERY or i + 1 == len(block)):
                progress(i + 1 - told)
                told = i + 1

    def _scan(self, now: Scan) -> None:
        self.stepper.noise = self.noise
        increment, belied, carried = self.driving.come(now.stamp_ns, now.odometry, now.ranges)
        if not self._begun:
            self._begin(now.stamp_ns)
            self.driving.direction.leg(increment)
            step, _ = self._observe(now)
            self._record(now, np.zeros(3), step)
            self.trail.key(now.stamp_ns, self.current, self.area.V)
            return
        if carried is Carried.MAYBE and self._is_farther_along(now, increment):
            carried = Carried.SURELY
        if carried is Carried.SURELY:
            self._put_down(now, increment)
            return
        c = self.config.filter
        missing = belied and self.driving.unnoticed(self.area, increment, now.view, self.key)
        near = math.hypot(increment[0], increment[1]) < c.key_distance
        if near and abs(increment[2]) < c.key_angle and not missing:
            self.trail.between(now.stamp_ns, increment)
            if self.config.refine.enabled:
                self.between.add(now.stamp_ns, now.view)
            return
        drive = self.driving.drive(self.area, self.current, increment, self.trail, missing=missing)
        self._key(now, drive, missing=missing)
        if self._is_lost():
            self._set_apart()

    def _key(
        self, now: Scan, drive: Drive, *, missing: bool = False, at_origin: bool = False
    ) -> None:
        """Use a scan; at_origin: it is a fragment's first, which the drive has not led into."""
        if not at_origin:
            self._set(drive.before.with_map(predict(drive.before.V, drive.motion)))
        step, came = self._observe(now, None if at_origin else drive)
        drive = came or drive
        if missing:
            self.driving.missed(self.current, drive, self.area)
        self._record(now, drive.increments[-1], step, trusted=drive.trusted)
        V, motion = self.area.V, None if at_origin else drive.motion
        self.trail.key(now.stamp_ns, self.current, V, motion)
        self._strays(now, drive, step)
        if self._is_lost():
            return  # through no door: where it seems to be, it is not
        if self.one_area:
            return
        distance = math.hypot(*drive.increments[-1, :2].tolist())
        area = self.crossings.step(
            Passing(now.stamp_ns, self.key - 1, distance, now.sight, now.view)
        )
        if area != self.current:
            self.current = area
            self.driving.direction.forget()
            self.trail.enter(area, self.area.V)
            if not self.crossings.lost:
                self.driving.stretches.end("lost", now.stamp_ns)

    def _strays(self, now: Scan, drive: Drive, step: Step) -> None:
        """Count key scans in a row that fit no wall known before them, and look through walls."""
        if self._astray and self._astray[0].area != self.current:
            self._astray = []
        before = self._astray[0].drive.before if self._astray else drive.before
        astray = self.stepper.is_poor(before, now.view, step, known=before.next_uid)
        if astray:
            R = self.area.V.robot
            origin, ends = moved(R, now.sight.origin[None]), moved(R, now.sight.ends)
            astray = (
                through_walls(before, origin, ends, self.config) > self.config.lost.seen_through
            )
        if astray:
            travelled = self.crossings.trace.length
            self._astray.append(Astray(now, drive, self.current, travelled, self._counted))
        else:
            self._astray = []
        self._counted = self.counts.copy()

    def _is_lost(self) -> bool:
        return len(self._astray) >= self.config.lost.scans

    def _set_apart(self) -> None:
        """The robot is lost: take back what it was taken to have seen, and map it by itself."""
        astray, self._astray = self._astray, []
        first, n = astray[0], len(astray)
        self._set(first.drive.before)
        self.trail.rewind(n, self.current, first.drive.before.V)
        if self.config.refine.enabled:
            self.keyscans.rewind(n)
        self.key -= n
        self.counts = first.counts
        self._wait(first.drive)
        self._adrift(first.now, first.drive, first.travelled, astray[-1].now.stamp_ns)
        for one in astray[1:]:
            increment = one.drive.increments[-1]
            motion = self.stepper.motion(self.area, increment, trusted=one.drive.trusted)
            self._wait(one.drive)
            self._key(one.now, one.drive._replace(before=self.area, motion=motion))

    def _is_farther_along(self, now: Scan, increment: Array) -> bool:
        """Whether the map tells that the robot was put down farther along the walls."""
        believed = se2.compose(self.area.V.robot, increment)
        there = self.crossings.places.seen(self.current)
        return farther_along(believed, now.sight, now.view, self.area, there, self.config)

    def _put_down(self, now: Scan, increment: Array) -> None:
        """The robot was carried: what it saw until then stands, it goes on by itself."""
        self._astray = []
        drive = self.driving.drive(self.area, self.current, increment, self.trail, missing=True)
        self._adrift(now, drive, self.crossings.trace.length, now.stamp_ns)

    def _adrift(self, first: Scan, drive: Drive, travelled: float, noticed_ns: int) -> None:
        """Begin an area that hangs on nothing with its first scan; `drive` has not led there."""
        self.trail.finish(self._motion)
        self.driving.stretches.begin("lost", drive.leg.stamps_ns[0], noticed_ns, area=self._name())
        self.current = self.crossings.set_apart(self.key, travelled)
        self.trail.enter(self.current, self.area.V)
        self.driving.direction.forget()
        self._key(first, drive._replace(before=self.area, trusted=False), at_origin=True)

    def _record(self, now: Scan, increment: Array, step: Step, *, trusted: bool = True) -> None:
        """Keep a key scan for the refinement, if there will be one."""
        if self.config.refine.enabled:
            walls = matched_walls(now.view, step)
            self.keyscans.add(
                now.stamp_ns, self.current, increment, now.view, walls, trusted=trusted
            )

    def finish(self) -> None:
        """The end of the log: scans that still wait for a key scan get their place.

        The robot goes with the last of them, so that the levels end where the trajectory ends.
        """
        if self._begun:
            left = self.trail.last_increment()
            self.trail.finish(self._motion)
            if left is not None:
                self._set(self.area.with_map(predict(self.area.V, self._motion(left))))
            self.crossings.finish()

    def _motion(self, increment: Array) -> Motion:
        return self.stepper.motion(self.area, increment)

    @property
    def portals(self) -> list[Portal]:
        """The doors found so far."""
        return self.crossings.portals

    @property
    def area(self) -> AreaMap:
        """The area in which the robot is."""
        return self.areas[self.current]

    def _set(self, area: AreaMap) -> None:
        self.areas[self.current] = area

    def _begin(self, stamp_ns: int) -> None:
        c = self.config
        V = initial_map(
            np.zeros(3),
            np.zeros((3, 3)),
            np.zeros(odometry_model.PARAMETERS),
            odometry_model.prior_covariance(c.odometry),
            c.coordinates,
        )
        self.areas.append(AreaMap(V, EMPTY))
        self._begun = True
        self._event(stamp_ns, "area_entered", area="A1")

    def _observe(self, now: Scan, drive: Drive | None = None) -> tuple[Step, Drive | None]:
        """Filter a scan; returns how the robot has come there after all, too."""
        stamp_ns, stepper = now.stamp_ns, self.stepper
        view = stepper.noisy(now.view)
        uid = self.area.features.uid
        known = len(uid)
        step: Step = observe(self.area, view, self.key, self.config)
        suspect = drive is not None and not drive.trusted
        other = None if drive is None else self.driving.direction.weigh(drive, self.key, view, step)
        if other is not None:
            step, drive = self._turned_about(other)
        elif suspect or stepper.is_poor(self.area, view, step):
            again = stepper.found_again(self.area, view, step, self.key, suspect=suspect)
            if again is not None:
                R = se2.between(step.area.V.robot, again.area.V.robot)
                self._event(stamp_ns, "relocated", area=self._name(), moved=R.tolist())
                step = again
        else:
            if step.surprise is not None:
                self.noise = adapted(self.noise, step.surprise, self.noise_rate, self.config.noise)
            if step.innovation is not None:
                self.innovations.add(self.key, self.current, uid, step.matches, step.innovation)
        self._set(step.area)
        n = self.counts
        n.keys += 1
        n.offered += step.offered
        n.matched += len(step.matches.wall)
        n.nis += step.nis
        n.degrees += step.degrees
        if step.offered and known and not len(step.matches.wall):
            n.failed += 1
            self._event(stamp_ns, "matching_failed", area=self._name(), segments=step.offered)
        self.key += 1
        if self.key % FORGET_EVERY == 0:
            area, forgotten = forget_unseen(self.area, self.key, self.config.forget)
            n.forgotten += forgotten
            self._set(area)
        return step, drive

    def _wait(self, drive: Drive) -> None:
        """The scans of a drive before its key scan, which wait for that."""
        for stamp_ns, increment in zip(drive.leg.stamps_ns[:-1], drive.increments, strict=False):
            self.trail.between(stamp_ns, increment)

    def _turned_about(self, other: Branch) -> tuple[Step, Drive]:
        """Believe the other hypothesis of the direction of motion, from where it began up to now.

        Returns its last step.
        """
        *earlier, last = other.told
        self.trail.rewind(len(earlier), self.current, other.told[0].drive.before.V)
        for one in other.told:
            self._wait(one.drive)
            if one is not last:
                V = one.step.area.V
                self.trail.key(one.drive.leg.stamps_ns[-1], self.current, V, one.drive.motion)
        if earlier and self.config.refine.enabled:
            increments = np.array([one.drive.increments[-1] for one in earlier])
            walls = np.concatenate([matched_walls(one.view, one.step) for one in earlier])
            self.keyscans.amend(increments, walls)
        self.crossings.amend({one.key: one.step.area.V.robot for one in earlier})
        self.driving.direction.take(other)
        if self.driving.direction.sign < 0.0:
            self.driving.stretches.begin(
                "odometry_reversed", other.since_ns, last.drive.leg.stamps_ns[-1], area=self._name()
            )
        else:
            self.driving.stretches.end("odometry_reversed", other.since_ns)
        return last.step, last.drive

    def _name(self) -> str:
        return f"A{self.current + 1}"

    def _event(self, stamp_ns: int, kind: str, **details: object) -> None:
        self.events.append(Event(stamp_ns, kind, details))
