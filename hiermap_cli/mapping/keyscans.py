"""The key scans of a run, as the whole log is gone over again with them.

What the filter used of the log, and nothing else: of every key scan its segments, and the
odometry by which the robot came there. The memory is a kilobyte a key scan.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.mapping.trail import Rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

# Columns of the table of segments.
_CENTRE, _THETA, _VAR_THETA, _VAR_Y = slice(0, 2), 2, 3, 4
_ENDS, _END_KIND, _END_SIGMA, _LENGTH = slice(5, 9), slice(9, 11), slice(11, 13), 13
_WALL = 14
_COLUMNS = 15
_BETWEEN_LENGTH, _BETWEEN_COLUMNS = 9, 10  # of scans between key scans


class ScanSegments(NamedTuple):
    """The S segments of all key scans, by scan, each in the robot's frame at its scan.

    scan: (S,) number of the key scan. The rest is as in `SegmentView`, with the sensor's noise
    alone. wall: (S,) uid of the wall of the scan's area with which the filter matched it, or -1.
    """

    scan: Index
    centre: Array
    theta: Array
    var_theta: Array
    var_y: Array
    ends: Array
    end_kind: Index
    end_sigma: Array
    length: Array
    wall: Index


class KeyScans(NamedTuple):
    """K key scans in the order of time.

    stamps_ns: (K,). area: (K,) the filter's area in which each was used. increments: (K, 3) the
    odometry since the key scan before, as the filter believed it (the first one's is zero).
    trusted: (K,) False where that odometry has failed.
    """

    stamps_ns: Index
    area: Index
    increments: Array
    trusted: NDArray[np.bool_]
    segments: ScanSegments


class BetweenScans(NamedTuple):
    """The scans that were no key scans. stamps_ns: (M,). segments: theirs, by scan."""

    stamps_ns: Index
    segments: ScanSegments


@dataclass(slots=True)
class BetweenRecord:
    """Scans between key scans as they come: their lines alone, in single precision."""

    _stamps: list[int] = field(default_factory=list)
    _count: list[int] = field(default_factory=list)
    _segments: list[NDArray[np.float32]] = field(default_factory=list)

    def add(self, stamp_ns: int, view: SegmentView) -> None:
        """One more scan."""
        n = len(view.length)
        table = np.empty((n, _BETWEEN_COLUMNS), dtype=np.float32)
        table[:, _CENTRE], table[:, _THETA] = view.centre, view.theta
        table[:, _VAR_THETA], table[:, _VAR_Y] = view.var_theta, view.var_y
        table[:, _ENDS] = view.ends.reshape(n, 4)
        table[:, _BETWEEN_LENGTH] = view.length
        self._stamps.append(stamp_ns)
        self._count.append(n)
        self._segments.append(table)

    def taken(self) -> BetweenScans:
        """All of them."""
        empty = np.zeros((0, _BETWEEN_COLUMNS), dtype=np.float32)
        table = np.concatenate((empty, *self._segments)).astype(float)
        none = np.zeros((len(table), 2))
        segments = ScanSegments(
            scan=np.repeat(np.arange(len(self._count)), self._count),
            centre=table[:, _CENTRE],
            theta=table[:, _THETA],
            var_theta=table[:, _VAR_THETA],
            var_y=table[:, _VAR_Y],
            ends=table[:, _ENDS].reshape(-1, 2, 2),
            end_kind=none.astype(np.int64),
            end_sigma=none,
            length=table[:, _BETWEEN_LENGTH],
            wall=np.full(len(table), -1),
        )
        return BetweenScans(np.array(self._stamps, dtype=np.int64), segments)


@dataclass(slots=True)
class KeyScanRecord:
    """Key scans as they come."""

    _stamps: list[int] = field(default_factory=list)
    _area: list[int] = field(default_factory=list)
    _trusted: list[bool] = field(default_factory=list)
    _count: list[int] = field(default_factory=list)
    _increments: Rows = field(default_factory=lambda: Rows(3))
    _segments: Rows = field(default_factory=lambda: Rows(_COLUMNS))

    def add(
        self,
        stamp_ns: int,
        area: int,
        increment: Array,
        view: SegmentView,
        walls: Index,
        *,
        trusted: bool,
    ) -> None:
        """One more key scan, and with which walls (uids, -1 for none) it was matched."""
        self._stamps.append(stamp_ns)
        self._area.append(area)
        self._trusted.append(trusted)
        self._increments.append(increment)
        n = len(view.length)
        self._count.append(n)
        if n:
            table = np.empty((n, _COLUMNS))
            table[:, _CENTRE], table[:, _THETA] = view.centre, view.theta
            table[:, _VAR_THETA], table[:, _VAR_Y] = view.var_theta, view.var_y
            table[:, _ENDS] = view.ends.reshape(n, 4)
            table[:, _END_KIND], table[:, _END_SIGMA] = view.end_kind, view.end_sigma
            table[:, _LENGTH], table[:, _WALL] = view.length, walls
            self._segments.extend(table)

    def amend(self, increments: Array, walls: Index) -> None:
        """The last n key scans came about by these increments (n, 3) after all.

        walls: (S,) of all their segments, as for `add`.
        """
        self._increments.drop(len(increments))
        self._increments.extend(increments)
        if len(walls):
            table = self._segments[-len(walls) :]
            table[:, _WALL] = walls
            self._segments.drop(len(walls))
            self._segments.extend(table)

    def rewind(self, keys: int) -> None:
        """Without the last key scans."""
        first = len(self) - keys
        self._segments.drop(sum(self._count[first:]))
        self._increments.drop(keys)
        for kept in (self._stamps, self._area, self._trusted, self._count):
            del kept[first:]

    def __len__(self) -> int:
        return len(self._stamps)

    def taken(self) -> KeyScans:
        """All of them."""
        table = np.asarray(self._segments)
        segments = ScanSegments(
            scan=np.repeat(np.arange(len(self)), self._count),
            centre=table[:, _CENTRE],
            theta=table[:, _THETA],
            var_theta=table[:, _VAR_THETA],
            var_y=table[:, _VAR_Y],
            ends=table[:, _ENDS].reshape(-1, 2, 2),
            end_kind=table[:, _END_KIND].astype(np.int64),
            end_sigma=table[:, _END_SIGMA],
            length=table[:, _LENGTH],
            wall=table[:, _WALL].astype(np.int64),
        )
        return KeyScans(
            stamps_ns=np.array(self._stamps, dtype=np.int64),
            area=np.array(self._area, dtype=np.int64),
            increments=np.asarray(self._increments),
            trusted=np.array(self._trusted, dtype=bool),
            segments=segments,
        )
