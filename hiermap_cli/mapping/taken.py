"""What the mapper takes in scan by scan, and what it counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hiermap_cli.mapping.odometry.direction import Drive
    from hiermap_cli.perception.seen import SeenBlock
    from hiermap_cli.perception.sight import Sight
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]


@dataclass(slots=True)
class Counts:
    """What the run's metrics are made of."""

    keys: int = 0
    offered: int = 0
    matched: int = 0
    failed: int = 0
    forgotten: int = 0
    nis: float = 0.0
    degrees: int = 0

    def copy(self) -> Counts:
        """As they are now. Written out: `dataclasses.replace` takes ten times as long."""
        return Counts(
            self.keys, self.offered, self.matched, self.failed, self.forgotten, self.nis,
            self.degrees,
        )  # fmt: skip


class Scan(NamedTuple):
    """A scan as it comes: its stamp, the odometry (3,) then, ranges (n,), and place in a block."""

    stamp_ns: int
    odometry: Array
    ranges: Array
    seen: SeenBlock
    place: int

    @property
    def view(self) -> SegmentView:
        """Its segments."""
        return self.seen.view(self.place)

    @property
    def sight(self) -> Sight:
        """The space that it tells of."""
        return self.seen.sight(self.place)


class Astray(NamedTuple):
    """A key scan that fits nothing where the robot is believed to be.

    area: the number of the area. travelled: metres of path before it. counts: those before it.
    """

    now: Scan
    drive: Drive
    area: int
    travelled: float
    counts: Counts
