"""`hiermap config`: the configuration as YAML, every key explained."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hiermap_cli.commands.common_options import PATH

if TYPE_CHECKING:
    from pathlib import Path


@click.command("config", short_help="Print the default configuration as YAML.")
@click.option(
    "--config",
    "file",
    metavar="FILE",
    type=PATH,
    help="Print the effective configuration with this file's values instead of the defaults.",
)
def command(file: Path | None) -> None:
    """Print the default configuration as YAML, every key explained.

    Write it to a file, change what you need, and give the file to `hiermap run --config`:

    \b
        hiermap config > office.yaml
        hiermap run log.mcap --config office.yaml
    """
    from hiermap_cli.config import Config
    from hiermap_cli.configfile import load_config
    from hiermap_cli.configtext import config_text

    click.echo(config_text(load_config(file) if file else Config()), nl=False)
