"""Where one file of a recording follows another: whether odometry goes on as it should there."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.logs.decimals import ns_to_seconds

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiermap_cli.logs.records import Odometry

DAY = 86_400.0  # seconds between two files that are hardly of one recording

# A step beyond is a jump: metres and radians, and what a robot may do in a second. However long
# nothing was recorded, a robot that drove on then is not where the map expects it.
_JUMP, _TURN_JUMP = (0.2, 2.5), (0.35, 4.0)
_LONGEST = 0.5  # seconds of driving between two files that need no word


class Seam(NamedTuple):
    """Two files that follow each other, by name, and the first reading of the second one."""

    before: str
    after: str
    first: Odometry
    log_ns: int


class SeamCheck:
    """Watches the readings of a log as they come, for the seams among them."""

    def __init__(self, seams: Sequence[Seam], *, by_header: bool) -> None:
        """`by_header`: the headers' stamps are the time, not the recorder's."""
        self._seams = {(seam.first, seam.log_ns): seam for seam in seams}
        self._by_header = by_header
        self._last: tuple[Odometry, int] | None = None
        self._warnings: list[str] = []

    def add(self, reading: Odometry, log_ns: int) -> None:
        """The next reading, and when the recorder wrote it."""
        seam = self._seams.get((reading, log_ns)) if self._seams else None
        if seam is not None and self._last is not None:
            self._cross(seam, *self._last)
        self._last = reading, log_ns

    def _cross(self, seam: Seam, last: Odometry, log_ns: int) -> None:
        first = seam.first
        ends = (last.stamp_ns, first.stamp_ns) if self._by_header else (log_ns, seam.log_ns)
        seconds = abs(ends[1] - ends[0]) * 1e-9
        metres = math.hypot(first.x - last.x, first.y - last.y)
        turn = abs(math.remainder(first.theta - last.theta, 2.0 * math.pi))
        driven = min(seconds, _LONGEST)
        names = f"{seam.before} and {seam.after}"
        if metres > _JUMP[0] + _JUMP[1] * driven or turn > _TURN_JUMP[0] + _TURN_JUMP[1] * driven:
            self._warnings.append(
                f"odometry jumps by {metres:.2f} m and {math.degrees(turn):.0f} degrees between "
                f"{names}: if they are two recordings, give them one at a time"
            )
        if seconds > DAY:
            self._warnings.append(
                f"{seconds / DAY:.1f} days lie between {names} (from {ns_to_seconds(ends[0])} s to "
                f"{ns_to_seconds(ends[1])} s): they may be two recordings"
            )

    def warnings(self) -> list[str]:
        """What a person should know, seam by seam."""
        return list(self._warnings)
