"""Everything that is watched while a log is read, for the warnings of `run` and `inspect`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiermap_cli.logs.clock_check import ClockCheck
from hiermap_cli.logs.join import plausible
from hiermap_cli.logs.odometry_check import OdometryCheck
from hiermap_cli.logs.records import Odometry
from hiermap_cli.logs.scan_check import ScanCheck
from hiermap_cli.logs.seams import SeamCheck

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from hiermap_cli.logs.clock import Timed
    from hiermap_cli.logs.records import Mount, ScanBlock
    from hiermap_cli.logs.seams import Seam


class Watch:
    """The checks of odometry, scans and clocks, fed as the log streams by."""

    def __init__(
        self, mount: Mount, seams: Sequence[Seam] = (), *, one_epoch: bool, by_header: bool = True
    ) -> None:
        """`seams`: between the files of the log; `by_header`: the headers' stamps are the time."""
        self.odometry = OdometryCheck()
        self.scans = ScanCheck(mount)
        self.clock = ClockCheck(one_epoch=one_epoch)
        self.seams = SeamCheck(seams, by_header=by_header) if seams else None

    def records(self, records: Iterable[Timed]) -> Iterator[Timed]:
        """The same records, seen."""
        note, compare, seams = self.odometry.add, self.clock.add, self.seams
        for timed in records:
            value = timed.value
            if isinstance(value, Odometry):
                if plausible(value):
                    note(timed.time_ns, value.x, value.y, value.theta)
                    if seams is not None:
                        seams.add(value, timed.log_ns)
            else:
                compare(value.stamp_ns, timed.log_ns)
            yield timed

    def blocks(self, blocks: Iterable[ScanBlock]) -> Iterator[ScanBlock]:
        """The same blocks, seen."""
        for block in blocks:
            self.scans.add(block)
            yield block

    def warnings(self) -> list[str]:
        """What a person should know of the log."""
        odometry = self.odometry.warnings(sign_is_lost=self.scans.backs_up)
        never_backward = self.odometry.never_backward
        return [
            *(self.seams.warnings() if self.seams is not None else ()),
            *self.scans.warnings(never_backward=never_backward),
            *odometry,
            *self.clock.warnings(),
        ]
