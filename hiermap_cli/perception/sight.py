"""What a scan says of the space about the robot: where its beams end, thinned to what that needs.

Doors and free space ask for coarser beams than walls do. Neighbouring beams are put together to
about `SPACING`, and the shortest of them speaks for all: nothing is taken for free that a beam
has not passed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.perception.beams import reach_limits, robot_angles

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig
    from hiermap_cli.logs.records import ScanBlock

    Array = NDArray[np.float64]

SPACING = 0.027  # radians between the beams that are kept
REACH = 10.0  # metres: farther ends are too sparse to say where something is not


class Sight(NamedTuple):
    """One scan. origin: (2,) the laser; ends: (n, 2) where its beams end; robot's frame."""

    origin: Array
    ends: Array


def sights(block: ScanBlock, config: LaserConfig) -> Iterator[Sight]:
    """One sight a scan of the block.

    Beams that say nothing, or saw nothing in reach, are left out: what swallows a beam may as
    well be black or glass. Beams beyond `REACH` end there, where they are known to be free.
    """
    angles = robot_angles(block.laser, block.mount)
    near, far = reach_limits(block.laser, config, np.inf)
    together = max(1, round(SPACING / abs(block.laser.angle_increment)))
    groups = max(1, block.laser.beams // together)
    together = min(together, block.laser.beams)
    ranges = block.ranges[:, : groups * together].astype(np.float64)
    ranges[~((ranges > near) & (ranges < far))] = np.inf
    ranges = ranges.reshape(len(block), groups, together)
    shortest = ranges.argmin(axis=2)
    length = np.take_along_axis(ranges, shortest[..., None], axis=2)[..., 0]
    beam = np.arange(groups) * together + shortest
    origin = np.array([block.mount.x, block.mount.y])
    valid = np.isfinite(length)
    length = np.minimum(length, REACH)
    with np.errstate(invalid="ignore"):
        ends = origin + length[..., None] * np.stack(
            (np.cos(angles)[beam], np.sin(angles)[beam]), axis=-1
        )
    for i in range(len(block)):
        yield Sight(origin, ends[i, valid[i]])
