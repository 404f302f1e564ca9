"""What a person sees of a run on stderr: a progress bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import sys
import time
from typing import TYPE_CHECKING

import click

from hiermap_cli.batch.run_log import Observer
from hiermap_cli.commands.boundary import one_line
from hiermap_cli.commands.closing import Closing

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from hiermap_cli.batch.run_log import RunOutcome

_NARROW = 60  # characters; what is narrower has its names wrapped too
_TOTALS = {"processor": "of the processor in all", "total": "by the clock in all"}
_LINE_EVERY = 10.0  # seconds between progress lines where there is no terminal


class Display(Closing, Observer):
    """An observer that can be closed, and that shows the outcome at the end."""

    def finish(self, outcome: RunOutcome) -> None:
        """Shows the summary."""


def make_display(*, quiet: bool, verbose: bool) -> Display:
    """The display that fits where stderr goes."""
    if quiet:
        return Display()
    return TerminalDisplay(verbose) if sys.stderr.isatty() else PlainDisplay(verbose)


class PlainDisplay(Display):
    """Lines, for a file or a pipe: few, and without control characters."""

    def __init__(self, verbose: bool) -> None:
        self._verbose = verbose
        self._done = 0
        self._begin = self._last = time.monotonic()

    def warned(self, warning: str) -> None:
        """One line."""
        _line(f"warning: {one_line(warning)}")

    def advanced(self, scans: int) -> None:
        """A line now and then in long runs."""
        self._done += scans
        now = time.monotonic()
        if now - self._last >= _LINE_EVERY:
            self._last = now
            rate = self._done / (now - self._begin)
            _line(f"{self._done} scans done, {rate:.0f} a second")

    def finish(self, outcome: RunOutcome) -> None:
        """A line per row of the summary."""
        if self._verbose:
            for line in verbose_lines(outcome):
                _line(line)
        for name, value in summary_rows(outcome):
            _line(f"{name}: {value}")


class TerminalDisplay(Display):
    """A progress bar with rate and time left, then a table."""

    wants_total = True

    def __init__(self, verbose: bool) -> None:
        from rich.console import Console

        self._verbose = verbose
        self._console: Console = Console(stderr=True, highlight=False, markup=False)
        self._progress: Progress | None = None

    def opened(self, log: str, scans: int | None) -> None:
        """Starts the bar."""
        from hiermap_cli.commands.bars import progress_bars

        self._progress = progress_bars(self._console, "rate")
        self._progress.start()
        self._task = self._progress.add_task(one_line(log), total=scans, rate="")

    def warned(self, warning: str) -> None:
        """A line above the bar."""
        self._console.print(f"warning: {one_line(warning)}", style="yellow")

    def advanced(self, scans: int) -> None:
        """Moves the bar on."""
        if self._progress is not None:
            task = self._progress.tasks[0]
            rate = (task.completed + scans) / task.elapsed if task.elapsed else 0.0
            self._progress.update(self._task, advance=scans, rate=f"{rate:.0f} scans/s")

    def entered(self, stage: str) -> None:
        """Says what goes on once the scans are through."""
        if self._progress is not None:
            self._progress.update(self._task, description=stage)

    def close(self) -> None:
        """Removes the bar."""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None

    def finish(self, outcome: RunOutcome) -> None:
        """The summary as a table."""
        from rich.box import SIMPLE_HEAD
        from rich.table import Table

        self.close()
        if self._verbose:
            for line in verbose_lines(outcome):
                self._console.print(line, soft_wrap=True)
        table = Table(box=SIMPLE_HEAD, show_header=False, title=outcome.log, title_justify="left")
        narrow = self._console.width < _NARROW
        table.add_column(
            style="bold", no_wrap=not narrow, max_width=_NARROW // 4 if narrow else None
        )
        table.add_column(overflow="fold")
        for name, value in summary_rows(outcome):
            table.add_row(name, value)
        self._console.print(table)


def _line(text: str) -> None:
    click.echo(text, err=True)


def summary_rows(outcome: RunOutcome) -> list[tuple[str, str]]:
    """The summary of a run as names and values, for any display."""
    values = outcome.values()
    kinds = {
        name.removeprefix("landmarks_"): int(value)
        for name, value in values.items()
        if name.startswith("landmarks_") and name != "landmarks_forgotten"
    }
    by_kind = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
    rows = [
        ("scans", str(outcome.scans)),
        ("areas", _areas(values)),
        ("landmarks", _count(values, "landmarks") + (f": {by_kind}" if by_kind else "")),
        ("doors", f"{_count(values, 'doors')}, {_count(values, 'door_crossings')} crossings"),
        ("matches", _count(values, "matches")),
        ("failures", _failures(values)),
        ("odometry error corrected", _correction(values)),
        ("time", _time(outcome)),
        ("results", str(outcome.output)),
    ]
    return [(name, value) for name, value in rows if value]


def verbose_lines(outcome: RunOutcome) -> list[str]:
    """Events in the order of time, then the processor's seconds in each stage and in all."""
    first = outcome.events[0].stamp_ns if outcome.events else 0
    lines = []
    for event in outcome.events:
        details = " ".join(f"{key}={_short(value)}" for key, value in event.details.items())
        lines.append(one_line(f"{(event.stamp_ns - first) / 1e9:9.2f} s  {event.kind} {details}"))
    # The totals are no stages.
    stages = {name: value for name, value in outcome.timing.items() if name not in _TOTALS}
    lines += [f"{seconds:9.3f} s  in {stage}" for stage, seconds in stages.items()]
    return lines + [
        f"{outcome.timing[name]:9.3f} s  {what}"
        for name, what in _TOTALS.items()
        if name in outcome.timing
    ]


def _short(value: object) -> str:
    """Numbers in four digits."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_short, value)) + "]"
    return str(value)


def _count(values: dict[str, float], name: str) -> str:
    return str(int(values[name])) if name in values else ""


def _areas(values: dict[str, float]) -> str:
    kinds = {"rooms": "room", "corridors": "corridor"}
    parts = [f"{int(values[name])} {kind}" for name, kind in kinds.items() if values.get(name)]
    other = int(values.get("areas", 0) - sum(values.get(name, 0) for name in kinds))
    parts += [f"{other} unknown"] if parts and other > 0 else []
    return _count(values, "areas") + (f": {', '.join(parts)}" if parts else "")


def _failures(values: dict[str, float]) -> str:
    count = _count(values, "matching_failures")
    return (
        f"{count} {'scan' if count == '1' else 'scans'} that matched nothing known" if count else ""
    )


def _correction(values: dict[str, float]) -> str:
    if "odometry_correction_end" not in values:
        return ""
    turn = math.degrees(values["odometry_correction_end_rot"])
    return (
        f"{values['odometry_correction_end']:.2f} m and {turn:.1f} deg at the end, "
        f"{values['odometry_correction_max']:.2f} m at most, "
        f"on {values['path_length']:.0f} m"
    )


def _time(outcome: RunOutcome) -> str:
    seconds = outcome.timing["total"]
    each = f", {1e3 * seconds / outcome.scans:.2f} ms a scan" if outcome.scans else ""
    return f"{seconds:.1f} s{each}"
