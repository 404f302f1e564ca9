"""Intervals between stamps, watched while a log streams by: their median and the gaps."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_KEPT = 5
_PER_OCTAVE = 16
_OCTAVES = 48  # of nanoseconds: up to three days
_GAP_FACTOR = 10.0
_GAP_LEAST = 1.0  # seconds


class Gap(NamedTuple):
    """`seconds` without a stamp from `at_ns` on."""

    seconds: float
    at_ns: int


class Intervals:
    """Statistics of the intervals of one row of stamps, in constant memory."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._bins = np.zeros(_OCTAVES * _PER_OCTAVE, dtype=np.int64)
        self._longest: list[Gap] = []

    def add(self, stamps_ns: NDArray[np.int64]) -> None:
        """The next stamps, in order."""
        if not len(stamps_ns):
            return
        if self._last is not None:
            stamps_ns = np.concatenate(([self._last], stamps_ns))
        steps = np.diff(stamps_ns)
        self._last = int(stamps_ns[-1])
        places = np.flatnonzero(steps > 0)
        if not len(places):
            return
        bins = (_PER_OCTAVE * np.log2(steps[places].astype(np.float64))).astype(np.int64)
        np.add.at(self._bins, np.minimum(bins, len(self._bins) - 1), 1)
        for place in places[np.argsort(steps[places])[-_KEPT:]].tolist():
            gap = Gap(float(steps[place]) * 1e-9, int(stamps_ns[place]))
            heapq.heappush(self._longest, gap)
            if len(self._longest) > _KEPT:
                heapq.heappop(self._longest)

    def median(self) -> float:
        """Seconds, to about 4 %; 0 where there is no interval."""
        total = int(self._bins.sum())
        if not total:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self._bins), 0.5 * total))
        return float(2.0 ** ((place + 0.5) / _PER_OCTAVE) * 1e-9)

    def longest(self) -> float:
        """Seconds of the longest interval; 0 where there is none."""
        return max((gap.seconds for gap in self._longest), default=0.0)

    def gaps(self) -> list[Gap]:
        """The longest intervals, longest first, that stand out by far."""
        limit = max(_GAP_LEAST, _GAP_FACTOR * self.median())
        return [gap for gap in sorted(self._longest, reverse=True) if gap.seconds > limit]
