"""What a simulation leaves on the disk: log.mcap, truth.tum and reference.json."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiermap_cli.documents import own_files
from hiermap_cli.documents.truth import REFERENCE, TRUTH, write_truth
from hiermap_cli.logs.mcap_writer import RosMcapWriter

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from hiermap_cli.simulation.simulator import Simulation

LOG = "log.mcap"
FILES = (LOG, TRUTH, REFERENCE)
SIMULATION = own_files.Contents(
    "an earlier simulation",
    FILES,
    {
        LOG: own_files.MCAP,
        TRUTH: own_files.TUM,
        REFERENCE: own_files.document("hiermap-reference"),
    },
)


def write(
    simulation: Simulation, directory: Path, progress: Callable[[int], None] | None = None
) -> None:
    """The log, the truth and the reference map, into an existing folder.

    truth.tum has the robot's true pose in the world frame at every scan; reference.json is in
    the same frame. The log's odometry begins at zero, wherever the robot stands in the world.

    Args:
        simulation: from `simulate`.
        directory: an empty folder.
        progress: told the number of scans written, after each block.

    Raises:
        OutputError, OSError: the files cannot be written.
    """
    write_truth(directory, simulation.stamps_ns, simulation.truth, simulation.reference_map)
    stamps_ns, odometry = simulation.odometry_ns.tolist(), simulation.odometry
    reading = 0
    with RosMcapWriter(directory / LOG, mount=simulation.world.stated_mount) as writer:
        for block in simulation.blocks():
            for stamp_ns, ranges in zip(block.stamps_ns.tolist(), block.ranges, strict=True):
                while reading < len(stamps_ns) and stamps_ns[reading] <= stamp_ns:
                    writer.odometry(stamps_ns[reading], odometry[reading])
                    reading += 1
                writer.scan(stamp_ns, ranges, block.laser)
            if progress is not None:
                progress(len(block))
        for left in range(reading, len(stamps_ns)):
            writer.odometry(stamps_ns[left], odometry[left])
