"""`hiermap run`: from a log to the landmark, area and environment models."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hiermap_cli.commands.boundary import session
from hiermap_cli.commands.common_options import PATH
from hiermap_cli.commands.options import InputOptions, log_options

if TYPE_CHECKING:
    from pathlib import Path

    from hiermap_cli.batch.run_log import RunOutcome


@click.command("run", short_help="Build the models of a log.")
@log_options
@click.option(
    "-o",
    "--output",
    metavar="DIR",
    type=PATH,
    help="Folder to write; LOG's own path with the ending .hiermap if not given.",
)
@click.option("--force", is_flag=True, help="Replace an earlier result in DIR.")
@click.option(
    "--config",
    "config_file",
    metavar="FILE",
    type=PATH,
    help="Configuration; see `hiermap config`.",
)
@click.option(
    "--no-refine",
    is_flag=True,
    help="The filter alone, without going over the log again.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON on stdout.")
@click.option("-q", "--quiet", is_flag=True, help="Nothing on stderr but errors.")
@click.option("-v", "--verbose", is_flag=True, help="Events, times, and tracebacks on stderr.")
def command(
    logs: tuple[Path, ...],
    chosen: InputOptions,
    output: Path | None,
    config_file: Path | None,
    *,
    force: bool,
    no_refine: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Build the landmark, area and environment models of LOG.

    Several LOGs are the parts of one recording. DIR gets model.json, report.json, trajectory.tum,
    trajectory_covariance.txt, trajectory_filter.tum and map.svg.

    \b
        hiermap run office.mcap
        hiermap run part_0.mcap part_1.mcap -o office --mount 0.1,0,0
    """
    from hiermap_cli.batch.run_log import default_output, run_log
    from hiermap_cli.commands.terminal import make_display
    from hiermap_cli.config import Config

    folder = output if output is not None else default_output(logs[0])
    state = session()
    state.verbose = verbose
    state.beside = folder.parent
    config = Config()
    if config_file is not None:
        from hiermap_cli.configfile import load_config

        config = load_config(config_file)
    config = config.model_copy(update={"input": chosen.over(config.input)})
    if no_refine:
        refine = config.refine.model_copy(update={"enabled": False})
        config = config.model_copy(update={"refine": refine})
    with make_display(quiet=quiet, verbose=verbose) as display:
        outcome = run_log(logs, config, folder, force=force, observer=display)
        display.finish(outcome)
    if as_json:
        click.echo(_summary_json(outcome))


def _summary_json(outcome: RunOutcome) -> bytes:
    import pydantic_core

    summary = {
        "output": str(outcome.output),
        "log": outcome.log,
        "scans": outcome.scans,
        "seconds": outcome.timing["total"],
        "metrics": outcome.values(),
        "warnings": list(outcome.warnings),
    }
    return pydantic_core.to_json(summary, indent=1)
