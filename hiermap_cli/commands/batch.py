"""`hiermap batch`: many logs, each in a worker of its own, nothing lost."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import click

from hiermap_cli.commands.boundary import session
from hiermap_cli.commands.common_options import PATH
from hiermap_cli.errors import EXIT_OK

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from hiermap_cli.batch.folder_lock import Shard

T = TypeVar("T")


def _parsed(
    parse: Callable[[str], T],
    ctx: click.Context,
    param: click.Parameter,
    text: str,
) -> T:
    try:
        return parse(text)
    except ValueError as error:
        raise click.BadParameter(str(error), ctx, param) from None


def _seconds(ctx: click.Context, param: click.Parameter, text: str | None) -> float | None:
    from hiermap_cli.batch.quantities import parse_seconds

    return None if text is None or text == "none" else _parsed(parse_seconds, ctx, param, text)


def _bytes(ctx: click.Context, param: click.Parameter, text: str | None) -> int | None:
    from hiermap_cli.batch.quantities import parse_bytes

    return None if text is None or text == "none" else _parsed(parse_bytes, ctx, param, text)


def _shard(ctx: click.Context, param: click.Parameter, text: str | None) -> Shard:
    from hiermap_cli.batch.folder_lock import Shard, parse_shard

    return Shard() if text is None else _parsed(parse_shard, ctx, param, text)


@click.command("batch", short_help="Run and evaluate many logs.")
@click.argument("jobs_file", metavar="JOBS", type=PATH)
@click.option(
    "-o",
    "--output",
    metavar="DIR",
    required=True,
    type=PATH,
    help="Folder of the results; what an earlier batch has finished there is kept.",
)
@click.option(
    "--workers",
    metavar="N",
    type=click.IntRange(min=1),
    help="Processes at work at once; one for every processor if not given.",
)
@click.option(
    "--time-limit",
    metavar="T",
    default="1h",
    show_default=True,
    callback=_seconds,
    help="Longest that a job may take: 90, 10m, 1.5h, or none.",
)
@click.option(
    "--memory-limit",
    metavar="M",
    callback=_bytes,
    help="Most memory that a job may hold: 500MB, 2GB. No limit if not given.",
)
@click.option(
    "--shard",
    metavar="I/N",
    callback=_shard,
    help="Do the I-th of N parts of the jobs, I from 1: for job arrays.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Do the jobs on a Dask cluster, as in tcp://HOST:8786, instead of --workers.",
)
@click.option("--json", "as_json", is_flag=True, help="Print summary.json on stdout.")
@click.option(
    "-q", "--quiet", is_flag=True, help="Nothing on stderr but errors: jobs that are not done."
)
@click.option(
    "-v", "--verbose", is_flag=True, help="Jobs that were kept, too; tracebacks on stderr."
)
def command(
    jobs_file: Path,
    output: Path,
    workers: int | None,
    time_limit: float | None,
    memory_limit: int | None,
    shard: Shard,
    scheduler: str | None,
    *,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Run and evaluate all jobs of the file JOBS.

    Each log is done in a process of its own: one that crashes, hangs or grows costs its own job.
    Results go to DIR/<job>/, reports over all to DIR/summary.json, DIR/junit.xml and
    DIR/summary.md. Said again, it does what is not done yet, failed jobs included.

    \b
        hiermap batch nightly.yaml -o nightly --workers 4 --memory-limit 2GB

    Exit status: 0, 1 if a job failed, 3 if a limit is missed; 1 goes before 3.
    """
    from hiermap_cli.batch.batch import Options, run_batch
    from hiermap_cli.batch.executors import usable_processors
    from hiermap_cli.batch.jobs_file import read_jobs
    from hiermap_cli.batch.memory import can_watch
    from hiermap_cli.batch.summary import SUMMARY
    from hiermap_cli.commands.batch_view import make_view

    if scheduler is not None and workers is not None:
        raise click.UsageError("--workers is for this machine; a --scheduler has its own workers")
    if memory_limit is not None and not can_watch():
        raise click.UsageError("--memory-limit needs /proc, which this system does not have")
    state = session()
    state.verbose = verbose
    state.beside = output.parent
    jobs = read_jobs(jobs_file)
    options = Options(
        workers=workers or usable_processors(),
        time_limit=time_limit,
        memory_limit=memory_limit,
        shard=shard,
        scheduler=scheduler,
    )
    with make_view(quiet=quiet, verbose=verbose, output=output) as view:
        tally = run_batch(jobs, output, options, view)
        view.ended(tally)
    if as_json:
        click.echo((output / SUMMARY).read_bytes(), nl=False)
    if tally.exit_status != EXIT_OK:
        raise click.exceptions.Exit(tally.exit_status)
