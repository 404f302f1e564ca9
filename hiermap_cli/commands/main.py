"""The command `hiermap`: finds the command asked for, and imports nothing else."""

from __future__ import annotations

import gc
import importlib
import os
import signal
import sys
import warnings
from typing import Any

import click

from hiermap_cli import __version__
from hiermap_cli.commands.boundary import Session, boundary, silence
from hiermap_cli.commands.streams import prepare_streams
from hiermap_cli.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE

# Command: what the help says of it. Each is `command` in the module of its name.
COMMANDS = {
    "run": "Build the landmark, area and environment models of a log.",
    "inspect": "Say what is in a log and what `run` would use.",
    "convert": "Write any log that can be read as a ROS 2 MCAP.",
    "simulate": "Make a log, its truth and its reference map from a floor plan.",
    "eval": "Measure a run against what is true, and hold limits.",
    "compare": "Compare two evaluations, and fail where one got worse.",
    "reference": "Make a reference map from a map_server map and a room segmentation.",
    "batch": "Run and evaluate many logs; resume where an earlier batch ended.",
    "config": "Print the default configuration as YAML, every key explained.",
    "validate": "Check documents against their schemas.",
}


class LazyGroup(click.Group):
    """A group that imports a command's module when the command is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names, in the order of the help."""
        del ctx
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command, or None where there is none of that name."""
        del ctx
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"hiermap_cli.commands.{cmd_name}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list of commands, from the table above: help imports none of them."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the command inside the boundary of errors."""
        with boundary(ctx.ensure_object(Session)):
            return super().invoke(ctx)


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog='Shell completion: add `eval "$(_HIERMAP_COMPLETE=bash_source hiermap)"` to ~/.bashrc '
    "(zsh_source and fish_source likewise).",
)
@click.version_option(__version__, "--version", prog_name="hiermap")
def cli() -> None:
    """Landmark, area and environment models, with covariances, from recorded robot logs."""


def main() -> None:
    """The entry point of the `hiermap` command."""
    # Read by BLAS when numpy is loaded, which nothing has done yet. On matrices as small as ours
    # two threads are thirty times slower than one.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    # Its plugins are asked for by reading the metadata of every installed package.
    os.environ["PYDANTIC_DISABLE_PLUGINS"] = "1"
    # Warnings of Python are for developers: the tests turn them into errors.
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    prepare_streams()
    # Hardly anything here is held by a cycle: looking for them finds next to nothing.
    gc.set_threshold(20_000, 20, 20)
    # What stops a batch system's job cleans up as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    status = _run(sys.argv[1:])
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        silence(sys.stdout.fileno())
    sys.exit(status)


def _run(arguments: list[str]) -> int:
    try:
        # The commands have a boundary of their own, which knows their options; this one is for
        # what is printed before one is found, as the help is.
        with boundary(Session()):
            result = cli.main(arguments, prog_name="hiermap", standalone_mode=False)
    except click.exceptions.Exit as error:
        return error.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return EXIT_USAGE
    except click.UsageError as error:
        hint = f"; see `{error.ctx.command_path} --help`" if error.ctx else ""
        click.echo(f"hiermap: {error.format_message().rstrip('.')}{hint}", err=True)
        return EXIT_USAGE
    except click.ClickException as error:
        click.echo(f"hiermap: {error.format_message()}", err=True)
        return EXIT_USAGE
    except click.Abort:
        click.echo("hiermap: interrupted", err=True)
        return EXIT_INTERRUPTED
    return result if isinstance(result, int) else EXIT_OK
