"""`hiermap inspect`: what is in a log, and what `run` would use."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiermap_cli.commands.boundary import one_line, session
from hiermap_cli.commands.options import InputOptions, log_options
from hiermap_cli.errors import EXIT_INPUT

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from hiermap_cli.logs.audit import AuditReport, TopicAudit, UseAudit

_PAGE = 160  # characters
_FOLDED = {"topic": 16, "type": 12}  # columns that may be folded: to so many characters
_DISPENSABLE = ("longest\ngap s", "type", "kind", "unreadable", "Hz")  # the first goes first


@click.command("inspect", short_help="Say what is in a log and what `run` would use.")
@log_options
@click.option(
    "--config",
    "config_file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Configuration whose input section counts.",
)
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON on stdout.")
@click.option("-v", "--verbose", is_flag=True, help="Tracebacks on stderr.")
def command(
    logs: tuple[Path, ...],
    chosen: InputOptions,
    config_file: Path | None,
    *,
    as_json: bool,
    verbose: bool,
) -> None:
    """Say what is in LOG: topics, types, rates, gaps, clocks, the laser and its mount.

    Several LOGs are the parts of one recording. The tables go to stdout, warnings to stderr.

    \b
        hiermap inspect office.mcap
        hiermap inspect recording_folder --json

    Exit status: 0 if `run` could use the log, 1 if not.
    """
    from hiermap_cli.config import Config
    from hiermap_cli.configfile import load_config
    from hiermap_cli.logs.audit import audit

    session().verbose = verbose
    config = load_config(config_file) if config_file is not None else Config()
    report = audit(logs, chosen.over(config.input))
    if as_json:
        import pydantic_core

        click.echo(pydantic_core.to_json(report.as_json(), indent=1))
    else:
        _show(report)
    for warning in report.warnings:
        click.echo(f"warning: {one_line(warning)}", err=True)
    for loss in report.lost:
        click.echo(f"lost: {one_line(loss)}", err=True)
    if report.fault is not None:
        click.echo(f"hiermap: {one_line(report.fault)}", err=True)
        raise click.exceptions.Exit(EXIT_INPUT)


def _show(report: AuditReport) -> None:
    """The tables: of the topics, and of what `run` would use."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    # Where there is no terminal, nothing is as narrow as one.
    width = None if sys.stdout.isatty() else _PAGE
    console = Console(highlight=False, markup=False, width=width)
    files = report.files[0] if len(report.files) == 1 else f"{len(report.files)} files"
    inside = "" if files == report.log else f", {files}"
    console.print(one_line(f"{report.log}: {report.log_format}{inside}"))
    if report.topics:
        shown, hidden = _columns(report.topics, console.width)
        topics = Table(box=SIMPLE_HEAD)
        for name in shown:
            topics.add_column(
                name,
                justify="left" if name in ("topic", "type", "kind") else "right",
                no_wrap=name not in _FOLDED,
                overflow="fold",
            )
        for topic in report.topics:
            cells = _topic_cells(topic)
            topics.add_row(*(cells[name] for name in shown))
        console.print(topics)
        if hidden:
            missing = ", ".join(name.replace("\n", " ") for name in hidden)
            console.print(f"not shown in {console.width} columns: {missing}")
    if report.use is not None:
        use = Table(box=SIMPLE_HEAD, show_header=False, title="run would use", title_justify="left")
        use.add_column(style="bold", no_wrap=True)
        use.add_column(overflow="fold")
        for name, value in _use_rows(report.use):
            use.add_row(name, one_line(value))
        console.print(use)


def _columns(topics: Sequence[TopicAudit], width: int) -> tuple[list[str], list[str]]:
    """The columns that a screen of `width` characters has room for, and those it has not.

    Names of topics and types may be folded, to `_FOLDED` characters at least; nothing else is cut.
    """
    rows = [_topic_cells(topic) for topic in topics]
    shown = list(rows[0])
    if not any(topic.undecodable for topic in topics):
        shown.remove("unreadable")  # names need the room more than a column of nothing
    needs = {
        name: 2 + max(len(line) for text in (name, *(row[name] for row in rows))
                      for line in text.split("\n"))
        for name in shown
    }  # fmt: skip
    needs |= {name: min(needs[name], 2 + least) for name, least in _FOLDED.items()}
    for name in _DISPENSABLE:
        if 2 + sum(needs[name] for name in shown) <= width:
            break
        if name in shown:
            shown.remove(name)
    return shown, [name for name in needs if name not in shown]


def _topic_cells(topic: TopicAudit) -> dict[str, str]:
    """The cells of a topic by column, in their order."""
    return {
        "topic": one_line(topic.name),
        "type": one_line(topic.type),
        "kind": topic.kind,
        "messages": str(topic.messages),
        "Hz": f"{topic.rate:.2f}",
        "longest\ngap s": f"{topic.longest_gap:.2f}",
        "unreadable": str(topic.undecodable) if topic.undecodable else "",
    }


def _use_rows(use: UseAudit) -> Iterator[tuple[str, str]]:
    laser = use.laser
    every, reading = (f"every {s:.2g} s or so" for s in (use.scan_period, use.odometry_period))
    yield "scans", f"{use.scan_topic}: {use.scans}, {every}"
    yield "odometry", f"{use.odometry_topic}: {use.odometry}, {reading}"
    yield "time", f"{use.first} to {use.last}, {use.duration:.1f} s, by {_CLOCKS[use.clock]}"
    yield "path", f"{use.path_length:.1f} m by odometry"
    yield "mount", f"{_mount_text(laser.mount)} ({laser.mount_source})"
    degrees = f"{math.degrees(laser.angle_min):.2f} to {math.degrees(laser.angle_max):.2f} deg"
    metres = f"{laser.range_min:.2f} to {laser.range_max:.2f} m"
    yield "laser", f"{laser.beams} beams from {degrees}, {metres}"
    nothing, silent = 100.0 * use.share_nothing_in_reach, 100.0 * use.share_saying_nothing
    shares = f"{nothing:.1f} % with nothing in reach, {silent:.1f} % that say nothing"
    yield "ranges", f"half of them below {use.median_range:.2f} m, {shares}"
    if use.dropped:
        counts = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in use.dropped.items())
        yield "dropped or mended", counts


def _mount_text(mount: Mapping[str, float | bool]) -> str:
    side = ", flipped" if mount["flipped"] else ""
    yaw = math.degrees(mount["yaw"])
    return f"x {mount['x']:.3f} m, y {mount['y']:.3f} m, yaw {yaw:.2f} deg{side}"


_CLOCKS = {
    "header": "header stamps",
    "log": "the recorder's time",
    "order": "the order of records",
}
