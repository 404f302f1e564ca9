"""`hiermap simulate`: a log, its truth and its reference map from a floor plan."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from hiermap_cli.commands.common_options import PATH

if TYPE_CHECKING:
    from pathlib import Path


@click.command("simulate", short_help="Make a log, its truth and its reference map.")
@click.argument("world", type=PATH, metavar="WORLD")
@click.option(
    "-o",
    "--output",
    "output",
    required=True,
    metavar="DIR",
    type=PATH,
    help="Folder to write log.mcap, truth.tum and reference.json into.",
)
@click.option(
    "--seed",
    default=1,
    show_default=True,
    type=click.IntRange(min=0),
    help="Of everything that happens by chance.",
)
@click.option(
    "--noise",
    type=click.Choice(["world", "none"]),
    default="world",
    show_default=True,
    help="The noise that the world says, or exact wheels and ranges.",
)
@click.option("--noiseless", is_flag=True, help="The same as --noise none.")
@click.option("--force", is_flag=True, help="Replace an earlier simulation in DIR.")
@click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors.")
def command(
    world: Path, output: Path, seed: int, noise: str, noiseless: bool, force: bool, quiet: bool
) -> None:
    """Drive a simulated robot through the floor plan WORLD and write what it recorded.

    WORLD is a YAML file: walls, doors, furniture, way points, laser, odometry, people (see
    datasets/ for examples). The same world, seed and version give the same log.

    \b
        hiermap simulate datasets/room.yaml -o room --seed 1
        hiermap run room/log.mcap -o room.hiermap
    """
    import numpy as np

    from hiermap_cli.documents.folder import output_folder
    from hiermap_cli.simulation.output import SIMULATION, write
    from hiermap_cli.simulation.simulator import simulate
    from hiermap_cli.simulation.world import load_world

    floor = load_world(world)
    with output_folder(output, SIMULATION, force=force, inputs=(world,)) as folder:
        rng = np.random.default_rng(seed)
        simulation = simulate(floor, rng, noiseless=noiseless or noise == "none")
        scans = len(simulation.stamps_ns)
        if quiet or not sys.stderr.isatty():
            write(simulation, folder)
        else:
            with click.progressbar(length=scans, label="scans", file=sys.stderr) as bar:
                write(simulation, folder, bar.update)
    if not quiet:
        seconds = 1e-9 * float(simulation.stamps_ns[-1] - simulation.stamps_ns[0])
        click.echo(
            f"{output}: {scans} scans, {len(simulation.odometry_ns)} odometry readings, "
            f"{seconds:.1f} s, {len(floor.plan.areas)} areas, {len(floor.plan.doors)} doors",
            err=True,
        )
