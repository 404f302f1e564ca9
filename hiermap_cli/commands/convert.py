"""`hiermap convert`: any log that can be read, as a ROS 2 MCAP."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from hiermap_cli.commands.boundary import one_line, session
from hiermap_cli.commands.common_options import path_option, said_options
from hiermap_cli.commands.options import InputOptions, log_options

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


@click.command("convert", short_help="Write any log that can be read as a ROS 2 MCAP.")
@log_options
@path_option("-o", "--output", metavar="X.mcap", required=True, help="File to write.")
@click.option("--force", is_flag=True, help="Replace X.mcap if it exists.")
@path_option("--config", "config_file", help="Configuration whose input section counts.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON on stdout.")
@said_options()
def command(
    logs: tuple[Path, ...],
    chosen: InputOptions,
    output: Path,
    config_file: Path | None,
    *,
    force: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Write LOG as a ROS 2 MCAP, on which `run` gives the same model.

    X.mcap gets the scans on /scan, the odometry on /odom and the laser's mount on /tf_static.
    Several LOGs are the parts of one recording.

    \b
        hiermap convert old.carmen.gz -o old.mcap
        hiermap convert recording_folder -o part.mcap --start 60 --end 120
    """
    from hiermap_cli.config import Config
    from hiermap_cli.configfile import load_config
    from hiermap_cli.logs.convert import check_target, convert
    from hiermap_cli.logs.recording import open_recording

    state = session()
    state.verbose = verbose
    state.beside = output.parent
    check_target(output, overwrite=force)
    config = load_config(config_file) if config_file is not None else Config()
    recording = open_recording(logs, chosen.over(config.input))
    with _progress(recording.log, hidden=quiet) as progress:
        done = convert(recording, output, overwrite=force, progress=progress)
    if not quiet:
        for warning in done.report.warnings:
            click.echo(f"warning: {one_line(warning)}", err=True)
        for loss in done.report.lost:
            click.echo(f"lost: {one_line(loss)}", err=True)
        click.echo(f"{output}: {done.scans} scans, {done.odometry} odometry readings", err=True)
    if as_json:
        import pydantic_core

        summary = {
            "output": str(output),
            "scans": done.scans,
            "odometry": done.odometry,
            "scan_topic": done.report.scan_topic,
            "odometry_topic": done.report.odometry_topic,
            "dropped": done.report.dropped,
            "warnings": done.report.warnings,
            "lost": done.report.lost,
        }
        click.echo(pydantic_core.to_json(summary, indent=1))


@contextmanager
def _progress(log: str, *, hidden: bool) -> Iterator[Callable[[int], None] | None]:
    """A counter of scans on a terminal, nothing elsewhere."""
    if hidden or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        TextColumn("{task.completed} scans", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(one_line(log), total=None)
        yield lambda scans: bar.advance(task, scans)
