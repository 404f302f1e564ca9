"""`hiermap validate`: any document against its schema and its rules."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

import click

from hiermap_cli.commands.boundary import one_line
from hiermap_cli.commands.common_options import PATH
from hiermap_cli.errors import (
    EXIT_INPUT,
    EXIT_OK,
    EXIT_USAGE,
    ConfigurationError,
    HiermapError,
    InputError,
)

if TYPE_CHECKING:
    from pathlib import Path

DOCUMENTS = (".json", ".tum", ".txt", ".yaml", ".yml", ".svg")
_UNKNOWN = (
    "is of no kind that is known by its keys ({}); known are configurations (the sections of "
    "`hiermap config`), worlds (areas, way_points), jobs (jobs), limits (limits) and maps of "
    "map_server (image, resolution)"
)
SCHEMAS = ("model", "report", "eval", "reference", "summary", "jobs")


@click.command("validate", short_help="Check documents against their schemas.")
@click.argument("files", nargs=-1, type=PATH, metavar="FILE...")
@click.option("--schema", type=click.Choice(SCHEMAS), help="Print a JSON Schema and do no more.")
def command(files: tuple[Path, ...], schema: str | None) -> None:
    """Check documents against their schemas and rules.

    Each FILE is recognised by its format key (model.json, report.json, eval.json, reference.json,
    summary.json, job.json), by its ending (.tum), by its columns (trajectory_covariance.txt,
    relations.txt), or, if it is YAML, by its keys (configuration, floor plan, jobs, limits, map of
    map_server). A folder stands for the documents in it. What holds is said on stdout, each fault
    on a line of its own on stderr.

    \b
        hiermap validate office.hiermap configs/*.yaml

    Exit status: 0 if all hold, 1 if a document does not, 2 if a configuration, a floor plan,
    jobs or limits have faults.
    """
    if schema is not None:
        from hiermap_cli.documents.schema import shipped_schema

        click.echo(shipped_schema(schema), nl=False)
        return
    if not files:
        raise click.UsageError("name at least one FILE, or give --schema")
    statuses = [_check(path) for named in files for path in _documents(named)]
    worst = EXIT_INPUT if EXIT_INPUT in statuses else max(statuses)
    raise click.exceptions.Exit(worst)


def _documents(path: Path) -> list[Path]:
    """The file, or the documents in the folder.

    Raises:
        InputError: the folder holds none.
    """
    if not path.is_dir():
        return [path]
    found = sorted(one for one in path.iterdir() if one.suffix in DOCUMENTS)
    if not found:
        raise InputError(f"{path}: no document in this folder ({', '.join(DOCUMENTS)})")
    return found


def _check(path: Path) -> int:
    """One file: its verdict is said, its exit status given back."""
    from hiermap_cli.documents.validate import check_file

    faults: list[str] = []
    try:
        if path.suffix.lower() in (".yaml", ".yml"):
            said = f"valid {_check_yaml(path)}"
        elif path.suffix.lower() == ".svg":
            said = "a picture, nothing to check"
        else:
            verdict = check_file(path)
            said, faults = f"valid {verdict.kind}", verdict.faults
    except ConfigurationError as error:
        for fault in error.faults:
            click.echo(f"{path}: {one_line(fault)}", err=True)
        return EXIT_USAGE
    except HiermapError as error:
        click.echo(one_line(str(error)), err=True)
        return error.exit_status
    for fault in faults:
        click.echo(f"{path}: {one_line(fault)}", err=True)
    if faults:
        return EXIT_INPUT
    click.echo(f"{path}: {said}")
    return EXIT_OK


def _check_yaml(path: Path) -> str:
    """The kind of a YAML file that holds.

    Raises:
        ConfigurationError: it has faults, or is of no kind that is known.
        InputError: it is a map whose image cannot be used.
    """
    from hiermap_cli.config import Config
    from hiermap_cli.configfile import load_config, top_keys

    keys = top_keys(path)
    if "jobs" in keys:
        from hiermap_cli.batch.jobs_file import read_jobs

        read_jobs(path)
        return "jobs"
    if "way_points" in keys or keys.get("areas") is list:
        from hiermap_cli.simulation.world import load_world

        load_world(path)
        return "world"
    if "limits" in keys:
        from hiermap_cli.batch.limits_file import read_limits

        read_limits(path)
        return "limits"
    if {"image", "resolution"} <= keys.keys():
        from hiermap_cli.documents.occupancy import read_map_server

        read_map_server(path)
        return "map (map_server)"
    known = Config.model_fields
    # A misspelt section is a fault of a configuration, which says what is meant.
    near = any(key in known or difflib.get_close_matches(key, known, n=1) for key in keys)
    if keys and "format" not in keys and not near:
        raise ConfigurationError(str(path), [_UNKNOWN.format(", ".join(list(keys)[:5]))])
    load_config(path)
    return "configuration"
