"""Does the robot stand where its odometry says that it stands?

Where odometry is missing the robot seems to stand, and no key scan would ever be taken. If it
truly stands, its laser sees at every moment what it saw just before, but for people who walk by.
One scan is no witness, since odometry may come a little earlier or later than the scans.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import OdometryFaultConfig

    Array = NDArray[np.float64]
    Ranges = NDArray[np.floating]

BEAMS = 90  # that are compared, at most
BACK = 2  # scans between those that are compared
STILL, STILL_ANGLE = 0.005, 0.005  # metres and radians of odometry that count as standing
WITNESSES = 3  # scans in a row


@dataclass(slots=True)
class Standstill:
    """Compares each scan with the one but last before it."""

    config: OdometryFaultConfig
    _before: list[tuple[Array, Ranges]] = field(default_factory=list)
    _witnesses: int = 0

    def belied(self, odometry: Array, ranges: Ranges) -> bool:
        """Whether by now the robot moves although odometry (3,) stays the same; ranges: (n,)."""
        now = ranges[:: max(1, len(ranges) // BEAMS)]
        self._before.append((odometry, now))
        if len(self._before) <= BACK:
            return False
        told, then = self._before.pop(0)
        dx, dy, dtheta = (odometry - told).tolist()
        still = dx * dx + dy * dy < STILL**2 and abs(dtheta) < STILL_ANGLE
        moves = still and len(now) == len(then) and self._changed(now, then)
        self._witnesses = self._witnesses + 1 if moves else 0
        return self._witnesses >= WITNESSES

    def _changed(self, now: Ranges, then: Ranges) -> bool:
        known = np.isfinite(now) & np.isfinite(then)
        n = int(np.count_nonzero(known))
        if n < BEAMS // 4:
            return False
        change = np.abs(now[known] - then[known])
        changed = int(np.count_nonzero(change > self.config.missing_change))
        return changed > self.config.missing_share * n
