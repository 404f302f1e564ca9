"""A block of scans as beams that run counterclockwise, and its returns as flat points.

Everything here has the robot's orientation and the **laser's origin**: ranges are distances from
the origin there, which the weights of a line fit need. Makers' habits end in this file: mirrored
mounts, negative increments, full circles, and returns that are no returns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig
    from hiermap_cli.logs.records import LaserGeometry, Mount, ScanBlock

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


class Beams(NamedTuple):
    """The beams of B scans, W each, counterclockwise, and the N points they returned.

    ranges: (B, W) metres, +inf nothing within `reach`, nan says nothing; flat returns below index
        its raveled form.
    first: (B,) the beam of `ScanBlock.ranges` that is in column 0 (full circles are turned so
        that the seam lies where no wall passes); `step` +1 or -1: beam = first + step * column.
    ux, uy: (beams,) unit vectors of the beams of `ScanBlock.ranges`.
    spacing: radians between columns. cyclic: the last column is followed by the first.
    cell: (N,) flat index scan * W + column, increasing. x, y, r: (N,) the points.
    """

    ranges: Array
    first: Index
    step: int
    ux: Array
    uy: Array
    spacing: float
    cyclic: bool
    reach: float
    cell: Index
    x: Array
    y: Array
    r: Array

    def beam(self, cell: Index) -> Index:
        """Index into the scan's own beams of flat cells, any shape."""
        width = self.ranges.shape[1]
        beam = self.first[cell // width] + self.step * (cell % width)
        return np.asarray(np.mod(beam, len(self.ux)) if self.cyclic else beam)


def robot_angles(laser: LaserGeometry, mount: Mount) -> Array:
    """Directions of the beams in the robot's orientation, shape (beams,), radians."""
    angles = laser.angles()
    return mount.yaw - angles if mount.flipped else mount.yaw + angles


def reach_limits(
    laser: LaserGeometry, config: LaserConfig, max_range: float
) -> tuple[float, float]:
    """The nearest and farthest range that is taken for a return, metres."""
    near = laser.range_min if config.range_min is None else config.range_min
    far = laser.range_max if config.range_max is None else config.range_max
    near = max(0.0, near)
    far = far if far > 0.0 else np.inf
    return near, min(far, max_range)


def arrange(block: ScanBlock, config: LaserConfig, max_range: float) -> Beams:
    """Beams and points of a block; see `Beams`."""
    angles = robot_angles(block.laser, block.mount)
    increment = block.laser.angle_increment
    spacing = abs(increment)
    step = -1 if (increment < 0) != block.mount.flipped else 1
    turn = round(2.0 * np.pi / spacing)
    cyclic = block.laser.beams >= turn - 1 and abs(turn * spacing - 2.0 * np.pi) < spacing
    width = min(block.laser.beams, turn) if cyclic else block.laser.beams
    cyclic = cyclic and width == turn

    near, far = reach_limits(block.laser, config, max_range)
    ranges = block.ranges[:, :width].astype(np.float64)
    with np.errstate(invalid="ignore"):
        ranges[ranges >= far] = np.inf
        ranges[ranges <= near] = np.nan
    first = np.full(len(ranges), 0 if step > 0 else width - 1, dtype=np.int64)
    ux, uy = np.cos(angles[:width]), np.sin(angles[:width])
    ranges = ranges[:, ::step]
    if cyclic:
        # Along a wall the range is convex, so that the farthest return lies at a wall's end.
        turned = np.argmax(np.where(np.isfinite(ranges), ranges, -1.0), axis=1)
        columns = (turned[:, None] + np.arange(width)) % width
        ranges = np.take_along_axis(ranges, columns, axis=1)
        dx, dy = ux[::step].take(columns), uy[::step].take(columns)
        first = (first + step * turned) % width
    else:
        # The same directions in every scan.
        dx, dy = ux[::step], uy[::step]
    ranges = np.ascontiguousarray(ranges)
    cell = np.flatnonzero(np.isfinite(ranges))
    with np.errstate(invalid="ignore"):
        x, y, r = (v.take(cell, mode="clip") for v in (ranges * dx, ranges * dy, ranges))
    return Beams(ranges, first, step, ux, uy, spacing, cyclic, far, cell, x, y, r)


def concatenated_ranges(start: Index, count: Index) -> Index:
    """`start[0] .. start[0] + count[0] - 1, start[1] ..`: one index array of all runs."""
    stop = np.cumsum(count)
    total = int(stop[-1]) if len(stop) else 0
    return np.arange(total) + np.repeat(start - stop + count, count)
