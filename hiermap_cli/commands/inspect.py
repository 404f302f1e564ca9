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
    from collections.abc import Iterator, Mapping

    from hiermap_cli.logs.audit import AuditReport, TopicAudit, UseAudit

_PAGE = 160  # characters


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
    topics = Table(box=SIMPLE_HEAD)
    for name in ("topic", "type"):
        topics.add_column(name, overflow="fold", min_width=12)
    topics.add_column("kind", no_wrap=True)
    # A terminal has 80 columns: names need them more than a column of nothing.
    numbers = ["messages", "Hz", "longest\ngap s"]
    if any(topic.undecodable for topic in report.topics):
        numbers.append("unreadable")
    for name in numbers:
        topics.add_column(name, justify="right", no_wrap=True)
    for topic in report.topics:
        topics.add_row(*list(_topic_cells(topic))[: len(topics.columns)])
    if report.topics:
        console.print(topics)
    if report.use is not None:
        use = Table(box=SIMPLE_HEAD, show_header=False, title="run would use", title_justify="left")
        use.add_column(style="bold", no_wrap=True)
        use.add_column(overflow="fold")
        for name, value in _use_rows(report.use):
            use.add_row(name, one_line(value))
        console.print(use)


def _topic_cells(topic: TopicAudit) -> Iterator[str]:
    yield one_line(topic.name)
    yield one_line(topic.type)
    yield topic.kind
    yield str(topic.messages)
    yield f"{topic.rate:.2f}"
    yield f"{topic.longest_gap:.2f}"
    yield str(topic.undecodable) if topic.undecodable else ""


def _use_rows(use: UseAudit) -> Iterator[tuple[str, str]]:
    laser = use.laser
    yield "scans", f"{use.scan_topic}: {use.scans}, every {use.scan_period:.3f} s"
    yield "odometry", f"{use.odometry_topic}: {use.odometry}, every {use.odometry_period:.3f} s"
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
