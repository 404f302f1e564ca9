"""What is in a log, whether or not `run` can use it: the body of `hiermap inspect`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiermap_cli.errors import InputError
from hiermap_cli.logs import records as kinds
from hiermap_cli.logs.decimals import ns_to_seconds
from hiermap_cli.logs.detect import open_source
from hiermap_cli.logs.gaps import Intervals
from hiermap_cli.logs.recording import InputReport, Recording, log_name, planned, sha256_of
from hiermap_cli.logs.records import Odometry, Record, Scan, Transform

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiermap_cli.config import InputConfig
    from hiermap_cli.logs.source import Source

_BATCH = 1024


@dataclass(frozen=True, slots=True)
class TopicAudit:
    """One topic: stamps are the recorder's, in seconds as text; rate in Hz."""

    name: str
    type: str
    encoding: str
    kind: str
    messages: int
    undecodable: int
    first: str | None
    last: str | None
    rate: float
    longest_gap: float


@dataclass(frozen=True, slots=True)
class LaserAudit:
    """The laser that `run` would use; angles in radians, lengths in metres."""

    mount: dict[str, float | bool]
    mount_source: str
    base_frame: str
    laser_frame: str
    beams: int
    angle_min: float
    angle_max: float
    angle_increment: float
    range_min: float
    range_max: float


@dataclass(frozen=True, slots=True)
class UseAudit:
    """What `run` would make of the log: stamps in seconds as text, lengths in metres."""

    scan_topic: str
    odometry_topic: str
    clock: str
    laser: LaserAudit
    scans: int
    odometry: int
    first: str
    last: str
    duration: float
    scan_period: float
    odometry_period: float
    path_length: float
    median_range: float
    share_nothing_in_reach: float
    share_saying_nothing: float
    dropped: dict[str, int]


@dataclass(frozen=True, slots=True)
class AuditReport:
    """A log as `inspect` shows it. `use` is None where `run` would refuse it, for `fault`."""

    log: str
    log_format: str
    files: tuple[str, ...]
    sha256: str
    topics: tuple[TopicAudit, ...]
    use: UseAudit | None
    fault: str | None
    warnings: tuple[str, ...]
    lost: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Plain values, with a format and version of their own."""
        return {"format": "hiermap-inspect", "version": [1, 0], **asdict(self)}


def audit(paths: Sequence[Path], options: InputConfig) -> AuditReport:
    """Reads a log twice: every topic as it is recorded, then as `run` would read it.

    Raises InputError where the log cannot be opened at all.
    """
    paths = [Path(path) for path in paths]
    source = open_source(paths)
    log = log_name(paths)
    topics, lost = _topics(source)
    use, fault, warnings = None, None, tuple[str, ...]()
    try:
        recording = planned(source, log, options)
        warnings = recording.plan.warnings
        for _ in recording.blocks():
            pass
        report = recording.report()
        use, warnings, lost = _use(recording, report), report.warnings, report.lost
    except InputError as error:
        fault = str(error)
    return AuditReport(
        log=log,
        log_format=source.format,
        files=tuple(path.name for path in source.paths),
        sha256=sha256_of(source.paths),
        topics=topics,
        use=use,
        fault=fault,
        warnings=warnings,
        lost=lost,
    )


class _Tally:
    """Counts and times of one topic's messages."""

    def __init__(self) -> None:
        self.messages = self.undecodable = 0
        self.first: int | None = None
        self.last = 0
        self.intervals = Intervals()
        self._batch: list[int] = []

    def add(self, log_ns: int) -> None:
        self.messages += 1
        if self.first is None:
            self.first = log_ns
        self.first, self.last = min(self.first, log_ns), max(self.last, log_ns)
        self._batch.append(log_ns)
        if len(self._batch) >= _BATCH:
            self.flush()

    def flush(self) -> None:
        import numpy as np

        self.intervals.add(np.array(self._batch, dtype=np.int64))
        self._batch = []


def _topics(source: Source) -> tuple[tuple[TopicAudit, ...], tuple[str, ...]]:
    """All topics by name, from a reading of the whole log; and what was lost in it."""
    tallies: dict[str, _Tally] = {}
    before: Record | None = None
    for record in source.records():
        if not record.topic and record.fault:
            continue  # a line that belongs to no topic; `dropped` counts it
        tally = tallies.setdefault(record.topic, _Tally())
        if record.fault:
            tally.undecodable += 1
        if before is None or not _same_message(before, record):
            tally.add(record.log_ns)
        before = record
    known = {topic.name: topic for topic in source.topics()}
    out = []
    for name in sorted(known.keys() | tallies.keys()):
        topic, tally = known.get(name), tallies.get(name, _Tally())
        tally.flush()
        seconds = 1e-9 * (tally.last - tally.first) if tally.first is not None else 0.0
        out.append(
            TopicAudit(
                name=name,
                type=topic.type if topic is not None else "",
                encoding=topic.encoding if topic is not None else "text",
                kind=topic.kind if topic is not None else kinds.OTHER,
                messages=tally.messages,
                undecodable=tally.undecodable,
                first=None if tally.first is None else ns_to_seconds(tally.first),
                last=None if tally.first is None else ns_to_seconds(tally.last),
                rate=(tally.messages - 1) / seconds if seconds > 0 else 0.0,
                longest_gap=tally.intervals.longest(),
            )
        )
    return tuple(out), tuple(source.losses)


def _same_message(before: Record, record: Record) -> bool:
    """Whether both came out of one message: several transforms, or odometry and its scan."""
    if (before.topic, before.log_ns) != (record.topic, record.log_ns):
        return False
    if isinstance(before.value, Transform):
        return True
    return isinstance(before.value, Odometry) and isinstance(record.value, Scan)


def _use(recording: Recording, report: InputReport) -> UseAudit:
    plan, watch = recording.plan, recording.watch
    assert watch is not None
    laser, scans = plan.first_laser, watch.scans
    first = scans.first_ns or 0
    beams = max(scans.beams_seen + scans.beams_far + scans.beams_silent, 1)
    return UseAudit(
        scan_topic=report.scan_topic,
        odometry_topic=report.odometry_topic,
        clock=plan.clock,
        laser=LaserAudit(
            mount=asdict(plan.mount),
            mount_source=plan.mount_source,
            base_frame=plan.base_frame,
            laser_frame=plan.laser_frame,
            beams=laser.beams,
            angle_min=laser.angle_min,
            angle_max=laser.angle_min + laser.angle_increment * (laser.beams - 1),
            angle_increment=laser.angle_increment,
            range_min=laser.range_min,
            range_max=laser.range_max,
        ),
        scans=report.scans,
        odometry=report.odometry,
        first=ns_to_seconds(first),
        last=ns_to_seconds(scans.last_ns),
        duration=1e-9 * (scans.last_ns - first),
        scan_period=scans.intervals.median(),
        odometry_period=watch.odometry.intervals.median(),
        path_length=watch.odometry.path,
        median_range=scans.median_range(),
        share_nothing_in_reach=scans.beams_far / beams,
        share_saying_nothing=scans.beams_silent / beams,
        dropped=report.dropped,
    )
