"""The mapper: a log's scans in, the three levels and the trajectory out."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.estimation import motion as odometry_model
from hiermap_cli.estimation.noise import NoiseScale, adapted, residual_factor
from hiermap_cli.estimation.stochastic_map import Motion, initial_map, predict
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_filter import Step, forget_unseen, observe
from hiermap_cli.mapping.area_map import EMPTY, AreaMap
from hiermap_cli.mapping.crossing import Crossings, Passing
from hiermap_cli.mapping.innovations import InnovationLog
from hiermap_cli.mapping.keyscans import KeyScanRecord
from hiermap_cli.mapping.model import Event
from hiermap_cli.mapping.relocation import relocate, robot_found, widened
from hiermap_cli.mapping.trail import Trail
from hiermap_cli.perception.segmentation import segment_block
from hiermap_cli.perception.sight import sights
from hiermap_cli.perception.views import scan_views, with_noise

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.logs.records import ScanBlock
    from hiermap_cli.mapping.portals import Portal
    from hiermap_cli.perception.sight import Sight
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]

FORGET_EVERY = 10
WARM_UP_BLOCKS = 16  # at most, however little the robot moves


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
    events: list[Event] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    trail: Trail = field(default_factory=Trail)
    keyscans: KeyScanRecord = field(default_factory=KeyScanRecord)
    innovations: InnovationLog = field(default_factory=InnovationLog)
    current: int = 0
    key: int = 0
    crossings: Crossings = field(init=False)
    noise: NoiseScale = field(default_factory=NoiseScale)
    noise_rate: float = 0.0
    _odometry: Array | None = None
    _wide: Config = field(init=False)

    def __post_init__(self) -> None:
        c = self.config
        wide = c.association.model_copy(update={"max_angle": c.relocation.slip_max_angle})
        self._wide = c.model_copy(update={"association": wide})
        self.crossings = Crossings(self.config, self.areas, self.events)

    def take(self, block: ScanBlock) -> None:
        """Segment a block of scans and filter them one by one."""
        segments = segment_block(block, self.config.laser, self.config.segmentation)
        views = scan_views(segments, len(block))
        seen = sights(block, self.config.laser)
        for i, (view, sight) in enumerate(zip(views, seen, strict=True)):
            self._scan(int(block.stamps_ns[i]), block.odometry[i], view, sight)

    def _scan(self, stamp_ns: int, odometry: Array, view: SegmentView, sight: Sight) -> None:
        if self._odometry is None:
            self._begin(stamp_ns, odometry)
            step = self._observe(stamp_ns, view)
            self._record(stamp_ns, np.zeros(3), view, step)
            self.trail.key(stamp_ns, self.current, self.area.V)
            return
        increment = se2.between(self._odometry, odometry)
        distance = float(np.hypot(increment[0], increment[1]))
        c = self.config.filter
        if distance < c.key_distance and abs(increment[2]) < c.key_angle:
            self.trail.between(stamp_ns, increment)
            return
        motion = self._motion(increment)
        suspect = self._implausible(stamp_ns, increment)
        if suspect:
            if distance > self.config.relocation.max_distance:
                # Farther than is searched: it never was there, and the wheels still told where
                # it was at the last scan.
                told = self.trail.last_increment()
                increment = np.zeros(3) if told is None else told
                motion = self._motion(increment)
                distance = float(np.hypot(motion.pose[0], motion.pose[1]))
            motion = odometry_model.distrusted(motion, self.config.odometry)
        self._set(replace(self.area, V=predict(self.area.V, motion)))
        self._odometry = odometry
        step = self._observe(stamp_ns, view, suspect=suspect)
        self._record(stamp_ns, increment, view, step, trusted=not suspect)
        self.trail.key(stamp_ns, self.current, self.area.V, motion)
        area = self.crossings.step(Passing(stamp_ns, self.key - 1, distance, sight, view))
        if area != self.current:
            self.current = area
            self.trail.enter(area, self.area.V)

    def _record(
        self,
        stamp_ns: int,
        increment: Array,
        view: SegmentView,
        step: Step,
        *,
        trusted: bool = True,
    ) -> None:
        """Keep a key scan for the refinement, if there will be one."""
        if self.config.refine.enabled:
            walls = np.full(len(view.length), -1)
            walls[step.matches.segment] = step.area.features.uid[step.matches.wall]
            self.keyscans.add(stamp_ns, self.current, increment, view, walls, trusted=trusted)

    def finish(self) -> None:
        """The end of the log: scans that still wait for a key scan get their place.

        The robot goes with the last of them, so that the levels end where the trajectory ends.
        """
        if self._odometry is not None:
            left = self.trail.last_increment()
            self.trail.finish(self._motion)
            if left is not None:
                self._set(replace(self.area, V=predict(self.area.V, self._motion(left))))
            self.crossings.finish()

    def _motion(self, increment: Array) -> Motion:
        """The motion of an odometry increment, by what is known of the odometry so far."""
        motion = odometry_model.motion(increment, self.area.V.parameters, self.config.odometry)
        return motion._replace(covariance=self.noise.odometry * motion.covariance)

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

    def _observe(self, stamp_ns: int, view: SegmentView, *, suspect: bool = False) -> Step:
        view = with_noise(view, self.config.filter, self.noise.laser, self.noise.walls)
        uid = self.area.features.uid
        known = len(uid)
        step: Step = observe(self.area, view, self.key, self.config)
        if suspect or self._poor(view, step):
            step = self._found_again(stamp_ns, view, step, suspect=suspect)
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
        return step

    def _found_again(self, stamp_ns: int, view: SegmentView, step: Step, *, suspect: bool) -> Step:
        """The step taken from where the scan itself says the robot is, if that explains more.

        That is a pose found among the walls, or else the prediction with room for an error.
        """
        c = self.config.relocation
        V = self.area.V
        found = relocate(self.area, view, c, suspect=suspect)
        tried = [robot_found(V, found.pose, c)] if found is not None else []
        tried.append(widened(V, c))
        for hypothesis in tried:
            area = replace(self.area, V=hypothesis)
            again = observe(area, view, self.key, self._wide)
            matched, total = _matched_length(view, again), float(view.length.sum())
            more = matched - _matched_length(view, step) >= max(c.gain * total, c.min_gain)
            if more and matched >= max(c.min_share * total, c.min_explained):
                moved = se2.between(step.area.V.robot, again.area.V.robot)
                self._event(stamp_ns, "relocated", area=self._name(), moved=moved.tolist())
                return again
        return step

    def _poor(self, view: SegmentView, step: Step) -> bool:
        total = float(view.length.sum())
        return (
            len(view.length) >= 3
            and len(self.area.features.uid) > 3
            and _matched_length(view, step) < self.config.relocation.poor_match * total
        )

    def _name(self) -> str:
        return f"A{self.current + 1}"

    def _event(self, stamp_ns: int, kind: str, **details: object) -> None:
        self.events.append(Event(stamp_ns, kind, details))


def laser_factor(block: ScanBlock, config: Config) -> float:
    """The laser's variance over the configured one, by the residuals of a block's line fits."""
    segments = segment_block(block, config.laser, config.segmentation)
    return residual_factor(segments.chi2, segments.points - 2, config.noise)


def _matched_length(view: SegmentView, step: Step) -> float:
    return float(view.length[step.matches.segment].sum())


def run_filter(
    blocks: Iterable[ScanBlock], config: Config, progress: Callable[[int], None] | None = None
) -> tuple[Mapper, dict[str, float]]:
    """The filter over the whole log; returns the mapper and the seconds of each stage."""
    started = time.process_time()
    stream = iter(blocks)
    first, noise = learn_noise(stream, config)
    learnt = time.process_time()
    mapper = Mapper(
        config, noise=noise, noise_rate=config.noise.rate if config.noise.estimate else 0.0
    )
    for block in chain(first, stream):
        mapper.take(block)
        if progress is not None:
            progress(len(block))
    mapper.finish()
    return mapper, {"noise": learnt - started, "filter": time.process_time() - learnt}


def learn_noise(stream: Iterator[ScanBlock], config: Config) -> tuple[list[ScanBlock], NoiseScale]:
    """The blocks at the log's beginning, and how large the noise is by a first run over them.

    So that the first walls are not entered with a noise that later proves wrong.
    """
    first: list[ScanBlock] = []
    if not config.noise.estimate or not config.noise.warm_up:
        return first, NoiseScale()
    scout = Mapper(config, noise_rate=config.noise.warm_up_rate)
    for block in stream:
        if not first:
            scout.noise = scout.noise._replace(laser=laser_factor(block, config))
        first.append(block)
        scout.take(block)
        if scout.counts.keys >= config.noise.warm_up or len(first) >= WARM_UP_BLOCKS:
            break
    return first, scout.noise
