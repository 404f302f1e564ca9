"""One time for all records of a log: which stamps count, and what is done with broken ones.

Stamps of the messages' headers are the time. Where they are unusable all along, the recorder's
time is; where that is unusable too, the order of records is the only time.

Within a log, a clock may be set back, and single stamps may be nonsense. A clock that is set
back is carried on from where it was, so that time never runs backwards; a single stamp that
does not fit its neighbours is replaced by the one before it. Each is counted.
"""

from __future__ import annotations

from collections import deque
from heapq import heappop, heappush
from itertools import islice, pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple

from hiermap_cli.logs.records import Odometry, Scan

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Iterable, Iterator, Sequence

    from hiermap_cli.logs.records import Record

Clock = Literal["header", "log", "order"]

SECOND = 1_000_000_000
WINDOW = 1 * SECOND  # records may come by so much later than their stamps say
LEAP = 10 * SECOND  # a step forward that must be confirmed by the records after it
FAR = 3600 * SECOND  # a first stamp so far from those after it is none
ORDER_STEP = SECOND // 10  # from one record to the next where only their order is known
AHEAD = 16  # records that confirm or refute a suspicious stamp
LATE = 4096  # records that may wait to be put in order


class Timed(NamedTuple):
    """A scan or odometry reading at its settled time.

    `own` is, for a scan, the odometry reading that the log gives for this very scan: the one
    directly before it with the same stamp.
    """

    time_ns: int
    sequence: int
    value: Scan | Odometry
    log_ns: int
    own: Odometry | None


def choose_clock(head: Sequence[tuple[int, int]]) -> Clock:
    """Which time to use, from the (header, log) stamps of a log's first records of one topic."""
    if _usable([header for header, _ in head]):
        return "header"
    return "log" if _usable([log for _, log in head]) else "order"


def _usable(stamps: Sequence[int]) -> bool:
    """More steps go forward than back, and a third of all: messages that are there twice repeat.

    One stamp alone is usable unless it is zero.
    """
    if len(stamps) < 2:
        return bool(stamps) and stamps[0] != 0
    forward = sum(b > a for a, b in pairwise(stamps))
    back = sum(b < a for a, b in pairwise(stamps))
    return forward >= back and 3 * forward >= len(stamps) - 1


def settle(records: Iterable[Record], clock: Clock, counts: Counter[str]) -> Iterator[Timed]:
    """Scans and odometry with settled times, still in log order.

    Times are at most WINDOW behind the latest one before them. `counts` gets
    `clock_set_back`, `stamp_outlier` (scans whose stamp was replaced) and
    `odometry_stamp_outlier` (readings left out).
    """
    source = _stamped(records, clock)
    ahead = deque(islice(source, AHEAD + 1))
    flow = _Flow(counts)
    before: tuple[int, Odometry] | None = None
    sequence = 0
    while ahead:
        raw_ns, record = ahead.popleft()
        following = next(source, None)
        if following is not None:
            ahead.append(following)
        time_ns = flow.time_of(raw_ns, record, ahead)
        if time_ns is None:
            continue
        value, own = record.value, None
        if isinstance(value, Odometry):
            before = (raw_ns, value)
        else:
            own = before[1] if before is not None and before[0] == raw_ns else None
            before = None
        assert isinstance(value, (Scan, Odometry))
        yield Timed(time_ns, sequence, value, record.log_ns, own)
        sequence += 1


class _Flow:
    """The flow of time so far: the latest time, the one before, and what is added to stamps."""

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._offset = 0
        self._started = False
        self._high = self._last = self._last_log = 0

    def time_of(
        self, raw_ns: int, record: Record, ahead: Sequence[tuple[int, Record]]
    ) -> int | None:
        """The settled time of a record; None for a reading that is left out."""
        time_ns: int | None = raw_ns + self._offset
        assert time_ns is not None
        if not self._started:
            time_ns = self._begin(raw_ns, record, ahead)
        elif not self._high - WINDOW <= time_ns <= self._high + LEAP:
            time_ns = self._mended(time_ns, record, [raw + self._offset for raw, _ in ahead])
        if time_ns is None:
            self._counts["odometry_stamp_outlier"] += 1
            return None
        if not self._started or time_ns > self._high:
            self._high = time_ns
        self._started = True
        self._last, self._last_log = time_ns, record.log_ns
        return time_ns

    def _begin(
        self, raw_ns: int, record: Record, ahead: Sequence[tuple[int, Record]]
    ) -> int | None:
        sound = _sound_first(raw_ns, [raw for raw, _ in ahead])
        if sound == raw_ns:
            return raw_ns
        if isinstance(record.value, Odometry):
            return None
        self._counts["stamp_outlier"] += 1
        return sound

    def _mended(self, time_ns: int, record: Record, later: list[int]) -> int | None:
        if _set_back(time_ns, later, self._high):
            pause = record.log_ns - self._last_log
            carried = self._last + (pause if 0 <= pause <= LEAP else 0)
            self._offset += carried - time_ns
            self._counts["clock_set_back"] += 1
            return carried
        if not _alone(time_ns, later, self._high):
            return time_ns
        if isinstance(record.value, Odometry):
            return None
        self._counts["stamp_outlier"] += 1
        return self._last


def _set_back(time_ns: int, later: list[int], high: int) -> bool:
    """Whether the clock was set back: the stamps that follow are behind, too."""
    return time_ns < high - WINDOW and _most(t < high - WINDOW for t in later)


def _alone(time_ns: int, later: list[int], high: int) -> bool:
    """Whether a stamp behind or far ahead is nonsense: those that follow go on as before."""
    if time_ns < high - WINDOW:
        return True
    return _most(high - WINDOW <= t <= high + LEAP for t in later)


def _sound_first(first: int, later: list[int]) -> int:
    """The log's first stamp; the first of those after it where it is far from them."""
    if not later:
        return first
    usual = sorted(later)[len(later) // 2]
    return first if abs(first - usual) <= FAR else next(t for t in later if abs(t - usual) <= FAR)


def _stamped(records: Iterable[Record], clock: Clock) -> Iterator[tuple[int, Record]]:
    """Scans and odometry with the stamp that counts."""
    step = -1
    line: tuple[int, int] | None = None
    for record in records:
        value = record.value
        if not isinstance(value, (Scan, Odometry)):
            continue
        if clock == "header":
            yield value.stamp_ns, record
        elif clock == "log":
            yield record.log_ns, record
        else:
            # A scan and the odometry it carries are one line of the log, at one time.
            carried = isinstance(value, Scan) and line == (value.stamp_ns, record.log_ns)
            step += 0 if carried else 1
            line = (value.stamp_ns, record.log_ns) if isinstance(value, Odometry) else None
            yield step * ORDER_STEP, record


def _most(answers: Iterable[bool]) -> bool:
    votes = list(answers)
    return bool(votes) and 2 * sum(votes) > len(votes)


def in_time_order(settled: Iterable[Timed], counts: Counter[str]) -> Iterator[Timed]:
    """The same values by time; those of equal time stay in log order.

    What is more than WINDOW late, or waits behind LATE others, is put at the time reached;
    `counts` gets `late_stamp`.
    """
    heap: list[Timed] = []
    reached = high = None
    for timed in settled:
        if reached is not None and timed.time_ns < reached:
            counts["late_stamp"] += 1
            timed = timed._replace(time_ns=reached)  # noqa: PLW2901
        heappush(heap, timed)
        high = timed.time_ns if high is None else max(high, timed.time_ns)
        while heap and (heap[0].time_ns <= high - WINDOW or len(heap) > LATE):
            out = heappop(heap)
            reached = out.time_ns
            yield out
    while heap:
        yield heappop(heap)
