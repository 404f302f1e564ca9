"""`hiermap reference`: a map_server map and a room segmentation as a reference map."""

from __future__ import annotations

from pathlib import Path

import click

from hiermap_cli.commands.boundary import session
from hiermap_cli.commands.common_options import PATH, path_option, said_options


@click.command("reference", short_help="Make a reference map from a map_server map.")
@click.argument("map_file", metavar="MAP.yaml", type=PATH)
@path_option(
    "--rooms",
    metavar="IMAGE",
    help="Room segmentation that lies on the map: one colour for each room, black between.",
)
@path_option(
    "--trajectory",
    help="Trajectory (TUM) in the map's frame: what it never entered is marked as not visited.",
)
@path_option(
    "-o",
    "--output",
    default=Path("reference.json"),
    help="The file to write; reference.json if not given.",
)
@click.option("--force", is_flag=True, help="Replace FILE if it is a reference map.")
@said_options()
def command(
    map_file: Path,
    rooms: Path | None,
    trajectory: Path | None,
    output: Path,
    *,
    force: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Turn MAP.yaml and its image into a reference map.

    Walls are traced as lines; with --rooms, rooms become areas, and doors are where two of them
    meet.

    \b
        hiermap reference map.yaml --rooms rooms.png -o reference.json
    """
    from hiermap_cli.batch.make_reference import make_reference

    state = session()
    state.verbose, state.beside = verbose, output.parent
    made = make_reference(map_file, output, rooms=rooms, trajectory=trajectory, force=force)
    if not quiet:
        parts = [f"{len(made.walls if made.walls is not None else ())} walls"]
        if made.areas is not None:
            parts.append(f"{len(made.areas)} areas")
        if made.doors is not None:
            parts.append(f"{len(made.doors)} doors")
        click.echo(f"{output}: {', '.join(parts)}", err=True)
