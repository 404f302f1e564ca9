"""How much room there is to the left and to the right of the robot, scan by scan."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.logs.records import ScanBlock

    Array = NDArray[np.float64]

HALF_WINDOW = 0.21  # radians about straight left and right: a jamb is seen in passing


class Clearance(NamedTuple):
    """Nearest return to each side of the robot, (B,) metres across the robot's heading; inf
    where that side is free in reach, nan where the laser does not look there."""

    left: Array
    right: Array


def beam_directions(block: ScanBlock) -> Array:
    """Headings of the beams in the robot's frame, (beams,)."""
    angles = block.laser.angles()
    if block.mount.flipped:
        angles = -angles
    return se2.wrap(angles + block.mount.yaw)


def clearance(block: ScanBlock) -> Clearance:
    """Clearances of every scan of the block, by the beams nearly straight left and right."""
    heading = beam_directions(block)
    sides = []
    for sign in (1.0, -1.0):
        beams = np.flatnonzero(np.abs(se2.wrap(heading - sign * 0.5 * np.pi)) <= HALF_WINDOW)
        if not len(beams):
            sides.append(np.full(len(block), np.nan))
            continue
        across = sign * np.sin(heading[beams]) * block.ranges[:, beams]
        across = np.where(np.isnan(across), np.inf, across) + sign * block.mount.y
        sides.append(across.min(axis=1))
    return Clearance(*sides)
