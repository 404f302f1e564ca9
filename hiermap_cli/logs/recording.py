"""A recorded log, opened: the values a run needs, and a report of what was read."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hiermap_cli.errors import InputError
from hiermap_cli.logs.clock import SECOND, Timed, in_time_order, settle
from hiermap_cli.logs.detect import open_source
from hiermap_cli.logs.join import in_blocks, join
from hiermap_cli.logs.records import Odometry, Scan
from hiermap_cli.logs.survey import Plan, make_plan, odometry_of
from hiermap_cli.logs.watch import Watch

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from hiermap_cli.config import InputConfig
    from hiermap_cli.logs.records import Mount, Record, ScanBlock
    from hiermap_cli.logs.seams import Seam
    from hiermap_cli.logs.source import Source


@dataclass(frozen=True, slots=True)
class InputReport:
    """What was read.

    `dropped` counts by reason what was left out or needed mending. `laser`: angles of the first and
    the last beam of the first scan in the robot's frame, radians, and its reach, metres.
    """

    log: str
    format: str
    files: tuple[str, ...]
    sha256: str
    scan_topic: str
    odometry_topic: str
    clock: str
    mount_source: str
    scans: int
    odometry: int
    dropped: dict[str, int]
    warnings: tuple[str, ...]
    lost: tuple[str, ...]
    laser: dict[str, float] = field(default_factory=dict)


def open_recording(paths: Sequence[Path], options: InputConfig) -> Recording:
    """Opens a log: one file, a folder, or the parts of a split recording.

    Raises InputError where it cannot be read, has no scans or no odometry, more than one topic
    fits, or its files contradict each other.
    """
    paths = [Path(path) for path in paths]
    return planned(open_source(paths), log_name(paths), options)


def planned(source: Source, log: str, options: InputConfig) -> Recording:
    """A source with the plan by which it is read. Raises InputError as `open_recording` does."""
    plan = make_plan(source, log, options)
    plan = plan._replace(warnings=(*source.twice, *plan.warnings))
    seams: tuple[Seam, ...] = ()
    if len(source.paths) > 1:
        from hiermap_cli.logs.parts import check_parts

        seams = check_parts(source, plan)
    return Recording(source, log, plan, options, seams)


def log_name(paths: Sequence[Path]) -> str:
    """How messages and reports call the log: no folder, for results are the same anywhere."""
    first = paths[0].resolve().name if paths[0].name in ("", "..") else paths[0].name
    more = len({path.resolve() for path in paths}) - 1
    return f"{first} and {more} more" if more else first


class Recording:
    """A log with the plan by which it is read."""

    def __init__(
        self,
        source: Source,
        log: str,
        plan: Plan,
        options: InputConfig,
        seams: tuple[Seam, ...] = (),
    ) -> None:
        self.source = source
        self.plan = plan
        self.log = log
        self._options = options
        self._seams = seams
        self._counts: Counter[str] = Counter()
        self.watch: Watch | None = None

    @property
    def mount(self) -> Mount:
        """The laser on the robot."""
        return self.plan.mount

    @property
    def scan_topic(self) -> str:
        """The topic of the scans."""
        return self.plan.scan_topic

    @property
    def odometry_topic(self) -> str:
        """The topic of the odometry, or of the transforms with the edge."""
        return self.plan.odometry.name

    def ordered(self) -> Iterator[Timed]:
        """Scans and odometry by their settled times."""
        self.watch = self._new_watch()
        yield from self.watch.records(self._in_order())

    def blocks(self, size: int = 512) -> Iterator[ScanBlock]:
        """All scans in time order, joined with odometry, in blocks of at most `size`.

        Repeated scans do not count towards `size`. Raises InputError at the end where no scan was
        read, or none with a valid range.
        """
        watch = self.watch = self._new_watch()
        settled = watch.records(self._in_order())
        joined = join(settled, self.plan.first_odometry, self._counts)
        blocks = in_blocks(joined, self.mount, self.plan.first_laser, size, self._counts)
        yield from watch.blocks(blocks)
        self.check(self._counts["scans"])
        if self._counts["no_valid_range"] == self._counts["scans"]:
            raise InputError(
                f"{self.log}: none of the {self._counts['scans']} scans on {self.scan_topic} has "
                "a valid range"
            )

    def report(self) -> InputReport:
        """What was read so far; whole once the blocks have been consumed."""
        counts = Counter(self._counts)
        scans, odometry = counts.pop("scans", 0), counts.pop("odometry", 0)
        return InputReport(
            log=self.log,
            format=self.source.format,
            files=tuple(path.name for path in self.source.paths),
            sha256=sha256_of(self.source.paths),
            scan_topic=self.scan_topic,
            odometry_topic=self.odometry_topic,
            clock=self.plan.clock,
            mount_source=self.plan.mount_source,
            scans=scans,
            odometry=odometry,
            dropped={reason: n for reason, n in sorted(counts.items()) if n},
            warnings=(*self.plan.warnings, *self._late_warnings()),
            lost=tuple(self.source.losses),
            laser=self._laser(),
        )

    def _laser(self) -> dict[str, float]:
        laser, mount = self.plan.first_laser, self.mount
        angles = laser.angle_min, laser.angle_min + (laser.beams - 1) * laser.angle_increment
        seen = [mount.yaw - angle if mount.flipped else mount.yaw + angle for angle in angles]
        reach = laser.range_max if math.isfinite(laser.range_max) else 0.0
        return {"first_angle": min(seen), "last_angle": max(seen), "range_max": reach}

    def _late_warnings(self) -> list[str]:
        """What only reading shows."""
        out = self.watch.warnings() if self.watch is not None else []
        if n := self._counts["repeated_scan"]:
            out.append(f"{n} scans are in the log twice, with the same stamp: they count once")
        if n := self._counts["clock_set_back"]:
            out.append(f"the clock was set back {n} times: later stamps are carried on from there")
        return out

    def _new_watch(self) -> Watch:
        # CARMEN's second stamp is the logger's own, which need not be of the same epoch.
        one_epoch = self.source.format not in ("CARMEN", "Wean")
        by_header = self.plan.clock != "log"
        return Watch(self.mount, self._seams, one_epoch=one_epoch, by_header=by_header)

    def _in_order(self) -> Iterator[Timed]:
        self._counts.clear()
        settled = settle(self._chosen(), self.plan.clock, self._counts)
        yield from self._within(in_time_order(settled, self._counts))

    def _chosen(self) -> Iterator[Record]:
        """Scans of the chosen topic and readings of the chosen odometry, faults counted."""
        scan_topic, choice = self.plan.scan_topic, self.plan.odometry
        records = self.source.records(frozenset({scan_topic}) | choice.topics)
        if choice.from_transforms:
            records = odometry_of(records, choice)
        for record in records:
            value = record.value
            if isinstance(value, Scan):
                if record.topic == scan_topic:
                    yield record
            elif isinstance(value, Odometry):
                if record.topic in choice.topics:
                    yield record
            elif record.fault:
                self._counts[record.fault.partition(":")[0].replace(" ", "_")] += 1

    def _within(self, records: Iterator[Timed]) -> Iterator[Timed]:
        """Records between --start and --end, and the odometry readings that enclose them."""
        start, end = self._options.start, self._options.end
        if start is None and end is None:
            yield from records
            return
        begin_ns = None
        before: Timed | None = None
        for timed in records:
            begin_ns = timed.time_ns if begin_ns is None else begin_ns
            elapsed = timed.time_ns - begin_ns
            reading = isinstance(timed.value, Odometry)
            if start is not None and elapsed < start * SECOND:
                before = timed if reading else before
                continue
            if before is not None:
                yield before
                before = None
            if end is None or elapsed <= end * SECOND:
                yield timed
            elif reading:
                yield timed
                return

    def check(self, scans: int) -> None:
        """Raises InputError where there was not a single scan."""
        if not scans:
            where = f"{self.log}: no scan on {self.scan_topic}"
            if self._options.start is not None or self._options.end is not None:
                raise InputError(f"{where} between --start and --end")
            raise InputError(f"{where} can be read")


def sha256_of(paths: Sequence[Path]) -> str:
    """Of the bytes of the file; of several files, of their digests one after the other."""
    digests = []
    for path in paths:
        try:
            with path.open("rb") as file:
                digests.append(hashlib.file_digest(file, "sha256"))
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(digests) == 1:
        return digests[0].hexdigest()
    return hashlib.sha256(b"".join(digest.digest() for digest in digests)).hexdigest()
