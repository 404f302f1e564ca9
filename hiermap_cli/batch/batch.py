"""A batch: every job of a list, whatever breaks, and its reports. The body of `hiermap batch`."""

from __future__ import annotations

import os
import shutil
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hiermap_cli.batch.content import read_record
from hiermap_cli.batch.executors import LocalExecutor
from hiermap_cli.batch.folder_lock import Shard, lock_folder, lock_path, summary_lock
from hiermap_cli.batch.job import kept_outcome
from hiermap_cli.batch.summary import (
    REPORTS,
    SUMMARY,
    Row,
    Tally,
    row_of,
    write_reports,
    write_summary,
)
from hiermap_cli.documents.own_files import begins
from hiermap_cli.errors import HiermapError, InputError, UsageError, output_error

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from hiermap_cli.batch.executors import Executor
    from hiermap_cli.batch.job import Job, Outcome
    from hiermap_cli.batch.worker_process import Event

UNFINISHED = ".partial"  # in the batch's folder; what is not whole yet
TIME_LIMIT = 3600.0  # seconds, for jobs that say nothing else: a hang ends some day


class View:
    """Is told how a batch goes; does nothing by itself. `event` comes from any thread."""

    watches_scans = False

    def planned(self, jobs: int, kept: int, workers: int) -> None:
        """So many jobs are to be done, besides `kept` that are done already."""

    def event(self, worker: int, job: Job, event: Event) -> None:
        """What a worker says of its job: `pid`, `total` and `scans`, `stage`."""

    def finished(self, outcome: Outcome) -> None:
        """A job ended."""

    def warned(self, warning: str) -> None:
        """Something that a person should know."""


class Options(NamedTuple):
    """How a batch is done.

    time_limit: seconds, memory_limit: bytes, for jobs that say nothing else; None is no limit.
    scheduler: the address of a Dask scheduler, which takes the place of `workers`.
    """

    workers: int = 1
    time_limit: float | None = TIME_LIMIT
    memory_limit: int | None = None
    shard: Shard = Shard()
    scheduler: str | None = None


def run_batch(
    jobs: Sequence[Job], folder: Path, options: Options | None = None, view: View | None = None
) -> Tally:
    """Does the jobs that are not done yet, and writes the reports over all of them.

    A job of which anything fails costs that job alone. The folder may be one that an earlier
    batch has left, in whatever state.

    Returns:
        How many jobs of this shard ended how.

    Raises:
        UsageError: another batch works in the folder, it cannot be written or holds a report
            that is none of a batch, or no scheduler answers.
        OutputError: the reports cannot be written.
    """
    view, options = view or View(), options or Options()
    shard = options.shard
    _check_reports(folder, shard)
    with lock_folder(folder, shard) as handles:
        workshops = folder / UNFINISHED / shard.label
        try:
            _clear(folder, workshops, shard)
            own = [_limited(job, options) for job in jobs[shard.index - 1 :: shard.count]]
            to_do, kept = _sorted_out(own, folder)
            # No more workers than there is work: each costs half a second to start.
            options = options._replace(workers=min(options.workers, len(to_do)))
            executor = _executor(folder, workshops, handles, options, view)
            view.planned(len(to_do), len(kept), options.workers)
            for outcome in kept:
                view.finished(outcome)
            failures: dict[str, Outcome] = {}
            with closing(executor.run(to_do)) as outcomes:
                for outcome in outcomes:
                    _note(outcome, folder, failures, view)
                    view.finished(outcome)
            return _report(jobs, own, folder, shard, failures)
        except OSError as error:
            raise output_error(folder, error) from error
        finally:
            shutil.rmtree(workshops, ignore_errors=True)
            _remove_if_empty(workshops.parent)


def _limited(job: Job, options: Options) -> Job:
    """The job with the limits of the batch where it has none of its own."""
    if job.time_limit is None:
        job = job._replace(time_limit=options.time_limit)
    if job.memory_limit is None:
        job = job._replace(memory_limit=options.memory_limit)
    return job


def _check_reports(folder: Path, shard: Shard) -> None:
    """Whether the reports in the folder may be replaced: only those that a batch has written."""
    for name in (*REPORTS, _shard_summary(shard)):
        path = folder / name
        if os.path.lexists(path) and not begins(path, REPORTS.get(name, REPORTS[SUMMARY])):
            raise UsageError(
                f"{path}: exists and is none that a batch wrote; "
                "move it elsewhere or choose another -o"
            )


def _clear(folder: Path, workshops: Path, shard: Shard) -> None:
    """Removes what a killed batch had not finished, and the reports that will be untrue."""
    shutil.rmtree(workshops, ignore_errors=True)
    workshops.mkdir(parents=True)
    names = tuple(REPORTS) if shard.is_whole else (_shard_summary(shard),)
    for name in names:
        (folder / name).unlink(missing_ok=True)
        # Nobody else writes here, so that what has its temporary name was never finished.
        for left in folder.glob(f".{name}.*"):
            left.unlink(missing_ok=True)


def _sorted_out(jobs: Sequence[Job], folder: Path) -> tuple[list[Job], list[Outcome]]:
    """The jobs that a worker must look at, and the outcomes of those that are surely done."""
    to_do, kept = [], []
    for job in jobs:
        row = _finished_row(job, folder)
        if row is None:
            to_do.append(job)
        else:
            kept.append(kept_outcome(job.name, row))
    return to_do, kept


def _finished_row(job: Job, folder: Path) -> dict[str, Any] | None:
    """The row of a job's result if it is there, of this job, and no file of it was touched."""
    record = None if job.is_remote else read_record(folder / job.name)
    if record is None or not record.is_of(job):
        return None
    try:
        unchanged = all(
            record.inputs[role].is_unchanged(Path(path)) for role, path in job.inputs().items()
        )
    except (InputError, KeyError):
        return None  # the worker says what is wrong
    return record.row if unchanged else None


def _executor(
    folder: Path, workshops: Path, handles: tuple[int, ...], options: Options, view: View
) -> Executor:
    if options.scheduler is not None:
        from hiermap_cli.batch.dask_executor import DaskExecutor

        lock = lock_path(folder, options.shard)
        return DaskExecutor(options.scheduler, folder, workshops, lock, view.warned)
    return LocalExecutor(
        folder,
        workshops,
        options.workers,
        keep_open=handles,
        tell=view.event,
        watched=view.watches_scans,
    )


def _note(outcome: Outcome, folder: Path, failures: dict[str, Outcome], view: View) -> None:
    """Keeps a failure for the reports, and the traceback of a fault beside the result's place."""
    path = folder / f"{outcome.name}.traceback.txt"
    if outcome.status != "failed":
        path.unlink(missing_ok=True)
        return
    failures[outcome.name] = outcome._replace(traceback=None)
    if outcome.traceback is None:
        path.unlink(missing_ok=True)
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(outcome.traceback, encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        view.warned(f"{path}: cannot be written ({error.strerror or error})")


def _report(
    jobs: Sequence[Job],
    own: Sequence[Job],
    folder: Path,
    shard: Shard,
    failures: dict[str, Outcome],
) -> Tally:
    """Writes the reports; those of shards are put together as they come."""
    if shard.is_whole:
        return write_reports(folder, lambda: (row_of(job, folder, failures) for job in own))
    tally = write_summary(
        folder / _shard_summary(shard), (row_of(job, folder, failures) for job in own)
    )
    with summary_lock(folder):
        others = [Shard(index, shard.count) for index in range(1, shard.count + 1)]
        rows = {other: _rows_of(folder / _shard_summary(other)) for other in others}
        write_reports(folder, lambda: _merged(jobs, rows, shard.count))
    return tally


def _merged(jobs: Sequence[Job], rows: dict[Shard, dict[str, Row]], count: int) -> Iterator[Row]:
    """The rows of all shards that have ended, in the order of the jobs."""
    for index, job in enumerate(jobs):
        row = rows[Shard(index % count + 1, count)].get(job.name)
        if row is not None:
            yield row


def _rows_of(path: Path) -> dict[str, Row]:
    """The rows in a shard's summary by name; none where it has not ended."""
    from hiermap_cli.documents.reading import read_json

    if not path.exists():
        return {}
    try:
        return {row["name"]: row for row in read_json(path)["jobs"]}
    except (HiermapError, KeyError, TypeError):
        return {}  # taken away by its shard, which has begun anew


def _shard_summary(shard: Shard) -> str:
    return f"summary-{shard.label}.json"


def _remove_if_empty(folder: Path) -> None:
    try:
        folder.rmdir()
    except OSError:
        return  # another shard is at work in it, or it is gone
