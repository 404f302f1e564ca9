"""Was the robot lifted while its odometry stood still, and put down elsewhere?

A robot that stands sees at every moment what it saw the moment before. If its odometry has not
moved between two such moments and many ranges are others, some longer and some shorter, then it
does not stand where it stood. People who come or go, and doors, change fewer of the ranges, or all
of them one way, or go on changing them; only who is carried from a room into a narrow corridor
has nearly all of them shorter. Unlike a scan that fits no wall this shows in a corridor
too, where from anywhere the same two walls are seen.

Who is put down farther along a long corridor sees so little else that people could have done it:
there only the map can tell, by a place that has been seen to look so.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.mapping.odometry.standstill import BEAMS, STILL, STILL_ANGLE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LostConfig

    Array = NDArray[np.float64]
    Ranges = NDArray[np.floating]

CALM = 0.1  # share of the ranges that change, at most, while a robot stands
EITHER_WAY = 0.15  # of the ranges that are others: at least so many longer, and so many shorter
NEARLY_ALL = 0.8  # of the ranges: if so many are others, no matter which way
DOUBTFUL = 0.5  # of the ranges that a robot put down has others: so many and it may have been


class Carried(IntEnum):
    """Whether the robot has been put down elsewhere."""

    NO = 0
    MAYBE = 1
    SURELY = 2


@dataclass(slots=True)
class CarryWatch:
    """Compares what the robot sees, when it stands, with what it saw where it stood before.

    The odometry (3,) and ranges (n,) of the last scan, and of the last one that was like the one
    before it, as long as the odometry is the same.
    """

    config: LostConfig
    _last: tuple[Array, Ranges] | None = None
    _stood: tuple[Array, Ranges] | None = None

    def put_down(self, odometry: Array, ranges: Ranges) -> Carried:
        """Whether the robot has been put down where it stands, by the second scan there."""
        now = odometry, ranges[:: max(1, len(ranges) // BEAMS)]
        last, self._last = self._last, now
        if last is None or not _same(last[0], odometry):
            self._stood = None
            return Carried.NO
        if sum(self._others(last[1], now[1])) > CALM:
            return Carried.NO
        stood, self._stood = self._stood, now
        if stood is None or not _same(stood[0], odometry):
            return Carried.NO
        longer, shorter = self._others(stood[1], now[1])
        both = longer + shorter
        either_way = min(longer, shorter) > EITHER_WAY * both
        if both > self.config.others and (either_way or both > NEARLY_ALL):
            return Carried.SURELY
        return Carried.MAYBE if both > DOUBTFUL * self.config.others else Carried.NO

    def forget(self) -> None:
        """The robot has moved, although its odometry has not told."""
        self._stood = None

    def _others(self, then: Ranges, now: Ranges) -> tuple[float, float]:
        """The shares of ranges that are longer now, and shorter."""
        if len(then) != len(now):
            return 0.0, 0.0
        known = np.isfinite(then) & np.isfinite(now)
        n = int(np.count_nonzero(known))
        if n < BEAMS // 4:
            return 0.0, 0.0
        change = now[known] - then[known]
        longer = int(np.count_nonzero(change > self.config.other_range))
        shorter = int(np.count_nonzero(change < -self.config.other_range))
        return longer / n, shorter / n


def _same(a: Array, b: Array) -> bool:
    dx, dy, dtheta = (a - b).tolist()
    return bool(dx * dx + dy * dy < STILL**2 and abs(dtheta) < STILL_ANGLE)
