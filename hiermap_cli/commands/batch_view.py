"""What a person sees of a batch on stderr: a live bar for every worker, or a line for every job."""

from __future__ import annotations

import sys
import threading
import time
from typing import TYPE_CHECKING, Any

import click

from hiermap_cli.batch.batch import View
from hiermap_cli.batch.quantities import bytes_text, seconds_text
from hiermap_cli.commands.boundary import one_line
from hiermap_cli.commands.closing import Closing

if TYPE_CHECKING:
    from pathlib import Path

    from rich.progress import Progress, TaskID

    from hiermap_cli.batch.job import Job, Outcome
    from hiermap_cli.batch.summary import Tally
    from hiermap_cli.batch.worker_process import Event


class BatchView(Closing, View):
    """A view that can be closed, and that shows the end; by itself it says nothing."""

    def ended(self, tally: Tally) -> None:
        """All jobs have ended and the reports are written."""


def make_view(*, quiet: bool, verbose: bool, output: Path) -> BatchView:
    """The view that fits where stderr goes."""
    if quiet:
        return QuietView()
    kind = TerminalView if sys.stderr.isatty() else PlainView
    return kind(verbose, output)


class QuietView(BatchView):
    """A line for each job that failed or missed a limit: what the exit status speaks of."""

    def finished(self, outcome: Outcome) -> None:
        """One line, if the job is not done."""
        if outcome.status != "done":
            click.echo(f"hiermap: {outcome_line(outcome)}", err=True)


class PlainView(BatchView):
    """Lines, for a file or a pipe: one a job, but none for those that are well and were kept."""

    def __init__(self, verbose: bool, output: Path) -> None:
        self._verbose = verbose
        self._output = output
        self._count = self._planned = 0
        self._begin = time.monotonic()

    def planned(self, jobs: int, kept: int, workers: int) -> None:
        """One line."""
        self._planned = jobs
        self._line(_plan(jobs, kept, workers))

    def finished(self, outcome: Outcome) -> None:
        """One line for each job that was done now, or that missed a limit."""
        if outcome.kept and outcome.status == "done" and not self._verbose:
            return
        self._count += not outcome.kept
        number = "" if outcome.kept else f"[{self._count}/{self._planned}] "
        self._line(number + outcome_line(outcome))

    def warned(self, warning: str) -> None:
        """One line."""
        self._line(f"warning: {one_line(warning)}")

    def ended(self, tally: Tally) -> None:
        """The counts, and where the results are."""
        for line in _ending(tally, self._output, time.monotonic() - self._begin):
            self._line(line)

    def _line(self, text: str) -> None:
        click.echo(text, err=True)


class TerminalView(BatchView):
    """A bar over all jobs and one for every worker; above them what went wrong."""

    watches_scans = True

    def __init__(self, verbose: bool, output: Path) -> None:
        from rich.console import Console

        self._verbose = verbose
        self._output = output
        self._console = Console(stderr=True, highlight=False, markup=False)
        self._progress: Progress | None = None
        self._lock = threading.Lock()
        self._bars: dict[int, TaskID] = {}
        self._room = 0
        self._begin = time.monotonic()

    def planned(self, jobs: int, kept: int, workers: int) -> None:
        """Starts the bars."""
        from hiermap_cli.commands.bars import progress_bars, room_for

        self._console.print(_plan(jobs, kept, workers))
        self._room = room_for(self._console, elapsed=True).name
        self._progress = progress_bars(self._console, "what", elapsed=True)
        self._all = self._progress.add_task("jobs", total=jobs, what="")
        self._progress.start()

    def event(self, worker: int, job: Job, event: Event) -> None:
        """Moves the bar of a worker."""
        with self._lock:
            progress = self._progress
            if progress is None:
                return
            if worker not in self._bars:
                self._bars[worker] = progress.add_task("", total=None, what="")
            bar = self._bars[worker]
            if "pid" in event:  # a job begins
                progress.reset(
                    bar, description=_short(job.name, self._room), total=None, what="opening"
                )
            changes: dict[str, Any] = {}
            if event.get("total") is not None:
                changes["total"] = event["total"]
            if "scans" in event:
                changes["completed"] = event["scans"]
            if "stage" in event:
                changes["what"] = event["stage"]
            progress.update(bar, **changes)

    def finished(self, outcome: Outcome) -> None:
        """Moves the bar over all; says what went wrong."""
        if self._progress is not None and not outcome.kept:
            self._progress.advance(self._all)
        if outcome.status != "done" or (self._verbose and not outcome.kept):
            style = {"failed": "red", "limit_missed": "yellow"}.get(outcome.status)
            self._console.print(outcome_line(outcome), style=style, soft_wrap=True)

    def warned(self, warning: str) -> None:
        """A line above the bars."""
        self._console.print(f"warning: {one_line(warning)}", style="yellow")

    def close(self) -> None:
        """Removes the bars."""
        with self._lock:
            progress, self._progress = self._progress, None
        if progress is not None:
            progress.stop()

    def ended(self, tally: Tally) -> None:
        """The counts, and where the results are."""
        self.close()
        for line in _ending(tally, self._output, time.monotonic() - self._begin):
            self._console.print(line, soft_wrap=True)


def outcome_line(outcome: Outcome) -> str:
    """A job in one line: `night/a: done, 3.2 s, 120 MB`."""
    parts = [outcome.status.replace("_", " ") + (", kept" if outcome.kept else "")]
    if outcome.reason:
        parts[0] += f": {one_line(outcome.reason)}"
    if outcome.seconds is not None:
        parts.append(seconds_text(outcome.seconds))
    if outcome.peak_memory is not None:
        parts.append(bytes_text(outcome.peak_memory))
    return f"{one_line(outcome.name)}: " + ", ".join(parts)


def _plan(jobs: int, kept: int, workers: int) -> str:
    if jobs == 0:
        return f"nothing to do: {kept} {'job' if kept == 1 else 'jobs'} done before"
    text = f"{jobs} {'job' if jobs == 1 else 'jobs'} on {workers} "
    text += "worker" if workers == 1 else "workers"
    return text + (f", {kept} done before" if kept else "")


def _ending(tally: Tally, output: Path, seconds: float) -> list[str]:
    return [f"{tally.text()}, in {seconds_text(seconds)}", f"results: {output}"]


def _short(name: str, room: int) -> str:
    """The end of a name, which tells most: bars have little room."""
    name = one_line(name)
    return name if len(name) <= room else "..." + name[len(name) - max(room - 3, 1) :]
