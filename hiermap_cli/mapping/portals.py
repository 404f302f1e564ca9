"""Where areas meet: doors, found while driving by a pinch of the free space.

While the robot passes a door, the jambs stand close on its left and right, and the space is
wider a little before and a little after. Furniture pinches too; a door's jambs are ends of
walls that run away from it across the direction of crossing (design: doors by several kinds of
evidence together).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, WALL, Features, joined
from hiermap_cli.estimation.stochastic_map import clone_robot

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import DoorConfig
    from hiermap_cli.mapping.area_map import AreaMap

    Array = NDArray[np.float64]


class Pinch(NamedTuple):
    """A narrow place just passed. frame: (3,) in the area: origin midway between the jambs, X
    along the line between them, Y in the direction of crossing. width: metres between them.
    travelled: metres of path at which it was passed."""

    frame: Array
    width: float
    travelled: float


@dataclass(slots=True)
class PinchDetector:
    """Watches the clearance along the path; one for each stay in an area."""

    config: DoorConfig
    travelled: list[float] = field(default_factory=list)
    width: list[float] = field(default_factory=list)
    frames: list[Array] = field(default_factory=list)
    last: float = -np.inf

    def passed(self, pose: Array, step: float, left: float, right: float) -> Pinch | None:
        """Take in one scan: pose (3,) in the area, metres since the last one, clearances.

        Returns the pinch that now lies `reach` behind the robot, if there is one.
        """
        c = self.config
        s = (self.travelled[-1] if self.travelled else 0.0) + step
        self.travelled.append(s)
        self.width.append(left + right if np.isfinite(left + right) else np.inf)
        y = 0.5 * (left - right) if np.isfinite(left + right) else 0.0
        self.frames.append(se2.compose(pose, np.array([0.0, y, -0.5 * np.pi])))
        while self.travelled[0] < s - 2.0 * c.reach - 0.5:
            del self.travelled[0], self.width[0], self.frames[0]
        at = np.asarray(self.travelled)
        width = np.asarray(self.width)
        middle = np.abs(at - (s - c.reach)) <= 0.5 * c.reach
        if not middle.any():
            return None
        i = int(np.flatnonzero(middle)[np.argmin(width[middle])])
        if width[i] > c.max_width or width[i] < c.min_width or at[i] - self.last < 0.5:
            return None
        if abs(at[i] - (s - c.reach)) > 0.25 * c.reach:
            return None
        before = width[(at < at[i]) & (at >= at[i] - c.reach)]
        after = width[(at > at[i]) & (at <= at[i] + c.reach)]
        if not len(before) or not len(after):
            return None
        if min(before.max(), after.max()) < width[i] + c.widening:
            return None
        self.last = float(at[i])
        return Pinch(self.frames[i], float(width[i]), float(at[i]))


def wall_evidence(area: AreaMap, pinch: Pinch, config: DoorConfig) -> float:
    """Metres of mapped wall that run away from the pinch along its line, both sides together.

    Walls within 25 degrees of the line between the jambs, near it, and reaching to within half a
    metre of a jamb.
    """
    f = area.features
    walls = np.flatnonzero(f.kind == WALL)
    if not len(walls):
        return 0.0
    R_d_w = se2.between(pinch.frame, area.V.poses[1 + walls])
    tilt = np.abs(np.sin(R_d_w[:, 2]))
    ends = se2.compose(
        R_d_w[:, None],
        np.stack([np.stack((v, 0 * v, 0 * v), axis=-1) for v in (f.lo[walls], f.hi[walls])], axis=1),
    )[..., :2]
    total = 0.0
    for side in (-1.0, 1.0):
        u = np.sort(side * ends[..., 0] - 0.5 * pinch.width, axis=1)
        inner = np.take_along_axis(ends, np.argmin(side * ends[..., 0], axis=1)[:, None, None], 1)
        ok = (tilt < 0.42) & (u[:, 0] < 0.5) & (u[:, 0] > -0.4) & (u[:, 1] > 0.2)
        ok &= np.abs(inner[:, 0, 1]) < config.wall_offset
        if ok.any():
            total += float(min(u[ok, 1].max(), 2.0))
    return total


def add_anchor(area: AreaMap, key: int) -> tuple[AreaMap, int]:
    """The area with the robot's present pose as an object; returns its uid.

    It is a copy of the robot, fully correlated with it: where the next area's frame hangs.
    """
    V = clone_robot(area.V)
    one = np.ones(1, dtype=np.int64)
    new = Features(
        uid=one * area.next_uid, kind=one * ANCHOR, wall=-one, side=0 * one,
        lo=np.zeros(1), hi=np.zeros(1), seen=one, last=one * key,
    )  # fmt: skip
    return type(area)(V, joined(area.features, new), area.next_uid + 1), area.next_uid
