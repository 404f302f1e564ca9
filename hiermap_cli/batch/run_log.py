"""One log into one folder of results: the body of `hiermap run`, and of every job of a batch."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.documents.folder import check_output, output_folder
from hiermap_cli.documents.report_file import report_json
from hiermap_cli.documents.results import REPORT, RESULT, write_result
from hiermap_cli.errors import UsageError
from hiermap_cli.logs.expected import expected_scans
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.mapping.metrics import model_metrics, trajectory_metrics

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.logs.records import ScanBlock
    from hiermap_cli.mapping.model import Event, HierarchicalModel, MapResult, Metric

_SHOWN = 5  # losses of a damaged log that are said aloud
ENDING = ".hiermap"
_LOG_ENDINGS = {".gz", ".bz2", ".mcap", ".bag", ".db3", ".carmen", ".clf", ".log", ".txt", ".dat"}


class Observer:
    """Is told how a run goes; does nothing by itself."""

    wants_total = False  # counting the scans beforehand costs a look through a text log

    def opened(self, log: str, scans: int | None) -> None:
        """The log can be read; `scans` is about how many there are, if that is known."""

    def warned(self, warning: str) -> None:
        """Something about the input that a person should know."""

    def advanced(self, scans: int) -> None:
        """So many more scans have been worked off."""

    def entered(self, stage: str) -> None:
        """A stage begins that is not counted in scans."""


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """What a run left: the folder, and what its report says.

    metrics: in the order of the report; events: in the order of time; timing: seconds of
    processor time by stage, and `total` by the clock on the wall.
    """

    output: Path
    log: str
    scans: int
    metrics: tuple[Metric, ...]
    events: tuple[Event, ...]
    timing: dict[str, float]
    warnings: tuple[str, ...]

    def values(self) -> dict[str, float]:
        """The metrics by name."""
        return {metric.name: metric.value for metric in self.metrics}


def default_output(log: Path) -> Path:
    """The log's own path with the ending .hiermap instead of its own.

    Raises UsageError where the log is the root of the file system, beside which nothing is.
    """
    if log.name in ("", ".."):  # as in `.` and `recording/..`
        log = log.resolve()
    if not log.name:
        raise UsageError(f"{log}: has nothing beside it; name an output folder with -o")
    while log.suffix.lower() in _LOG_ENDINGS:
        log = log.with_suffix("")
    return log.with_name(log.name + ENDING)


def run_log(
    paths: Sequence[Path],
    config: Config,
    output: Path,
    *,
    force: bool = False,
    observer: Observer | None = None,
) -> RunOutcome:
    """Reads a log (one file, a folder, or the parts of a split one), maps it, writes `output`.

    Raises:
        InputError: the log cannot be used.
        UsageError: `output` exists and may not be replaced, or cannot be written.
        OutputError: the disk is full.
    """
    check_output(output, RESULT, force=force, inputs=paths)
    mapped = MappedLog(paths, config, observer)
    with output_folder(output, RESULT, force=force, inputs=paths) as folder:
        outcome = mapped.write(folder)
    return replace(outcome, output=Path(output))


class MappedLog:
    """A log that was read and mapped, and is to be written."""

    def __init__(
        self, paths: Sequence[Path], config: Config, observer: Observer | None = None
    ) -> None:
        """Reads and maps the log.

        Raises:
            InputError: the log cannot be used.
        """
        from hiermap_cli.mapping.run import map_log

        self._observer = observer = observer or Observer()
        self._clock = clock = _Clock()
        self._config = config
        recording = open_recording(paths, config.input)
        total = expected_scans(recording) if observer.wants_total else None
        observer.opened(recording.log, total)
        for warning in recording.plan.warnings:
            observer.warned(warning)
        clock.lap("open")
        watched = _Watched(observer)
        self._result = result = map_log(
            watched.through(recording.blocks()), config, watched.worked_off
        )
        self._timing = {**clock.laps, "read": watched.seconds, **result.timing}
        clock.lap("map")
        observer.entered("writing")
        source = recording.report()
        empty = _empty(result.model, source.scans)
        self.source = source = replace(source, warnings=(*source.warnings, *empty))
        late = (*source.warnings[len(recording.plan.warnings) :], *_some(source.lost))
        for warning in late:
            observer.warned(warning)
        self._warnings = (*recording.plan.warnings, *late)
        self._metrics = _all_metrics(result, watched.odometry())

    def write(self, folder: Path) -> RunOutcome:
        """Writes everything into `folder`, which exists and is empty.

        Raises:
            OSError: the files cannot be written.
        """
        result, source = self._result, self.source
        write_result(folder, result)
        self._clock.lap("write")
        timing = self._timing | {"write": self._clock.laps["write"], **self._clock.totals()}
        dropped = dict(source.dropped)
        for reason, count in result.dropped.items():
            dropped[reason] = dropped.get(reason, 0) + count
        report = report_json(
            source={**asdict(source), "dropped": dropped},
            config=self._config,
            metrics=self._metrics,
            events=result.events,
            timing=timing,
            consistency=result.consistency,
        )
        (folder / REPORT).write_bytes(report)
        return RunOutcome(
            output=folder,
            log=source.log,
            scans=source.scans,
            metrics=self._metrics,
            events=result.events,
            timing=timing,
            warnings=self._warnings,
        )


def _some(lost: tuple[str, ...]) -> tuple[str, ...]:
    """What was lost, for a person: all of it is in the report."""
    more = len(lost) - _SHOWN
    return lost if more <= 0 else (*lost[:_SHOWN], f"and {more} losses more, see {REPORT}")


def _empty(model: HierarchicalModel, scans: int) -> tuple[str, ...]:
    """A warning where there is a model, but nothing in it."""
    if model.landmarks:
        return ()
    counted = f"{scans} {'scan' if scans == 1 else 'scans'}"
    said = (
        f"no landmarks were found in {counted}: the model holds no walls, corners or doors; give a "
        "longer part of the log, in which the robot moves among walls, or see with `hiermap "
        "inspect` whether the log is whole and the laser's ranges and mount are right"
    )
    return (said,)


class _Clock:
    """Seconds of processor time between laps, and of both kinds since the beginning."""

    def __init__(self) -> None:
        self._begin, self._last = time.perf_counter(), time.process_time()
        self.laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        now = time.process_time()
        self.laps[name] = now - self._last
        self._last = now

    def totals(self) -> dict[str, float]:
        return {"processor": time.process_time(), "total": time.perf_counter() - self._begin}


class _Watched:
    """Passes blocks on, and keeps what the report needs of them: odometry and reading time.

    Tells the observer how many scans the filter has worked off, and when it is through.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._odometry: list[NDArray[np.float64]] = []
        self._read = self._done = 0
        self._at_end = False
        self.seconds = 0.0

    def through(self, blocks: Iterable[ScanBlock]) -> Iterator[ScanBlock]:
        """The blocks, as they are asked for."""
        iterator = iter(blocks)
        while True:
            begin = time.process_time()
            block = next(iterator, None)
            self.seconds += time.process_time() - begin
            if block is None:
                break
            self._odometry.append(block.odometry)
            self._read += len(block)
            yield block
        self._at_end = True
        # Of a short log all is read to learn the noise, before the filter begins.
        if self._done:
            self._finish()

    def worked_off(self, scans: int) -> None:
        """The filter has used so many more scans."""
        self._done += scans
        self._observer.advanced(scans)
        if self._at_end and self._done >= self._read:
            self._finish()

    def _finish(self) -> None:
        if self._done < self._read:  # those that the mapper leaves out
            self._observer.advanced(self._read - self._done)
            self._done = self._read
        self._observer.entered("refining")

    def odometry(self) -> NDArray[np.float64]:
        """The odometry of every scan, (N, 3)."""
        return np.concatenate(self._odometry) if self._odometry else np.zeros((0, 3))


def _all_metrics(result: MapResult, odometry: NDArray[np.float64]) -> tuple[Metric, ...]:
    """The estimator's own figures, and those that its result shows; the estimator's go first."""
    counted = model_metrics(result.model)
    measured = trajectory_metrics(result.trajectory, result.trajectory_filter, odometry)
    known = {metric.name for metric in result.metrics}
    return (*result.metrics, *(m for m in (*counted, *measured) if m.name not in known))
