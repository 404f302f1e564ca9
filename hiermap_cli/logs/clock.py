"""One time for all records of a log: which stamps count, and what is done with broken ones.

Stamps of the messages' headers are the time. Where they are unusable all along, the recorder's
time is; where that is unusable too, the order of records is the only time.

Within a log, a clock may be set back, and single stamps may be nonsense. A clock that is set
back is carried on from where it was, so that time never runs backwards; a single stamp that
does not fit its neighbours is replaced by the one before it. Each is counted.
"""

from __future__ import annotations

from collections import Counter, deque
from heapq import heappop, heappush
from itertools import islice, pairwise
from statistics import median, median_low
from typing import TYPE_CHECKING, Literal, NamedTuple

from hiermap_cli.logs.records import Odometry, Scan

if TYPE_CHECKING:
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
    """At least half of the steps go forward; one stamp alone is usable unless it is zero."""
    if len(stamps) < 2:
        return bool(stamps) and stamps[0] != 0
    forward = sum(b > a for a, b in pairwise(stamps))
    return 2 * forward >= len(stamps) - 1


def settle(records: Iterable[Record], clock: Clock, counts: Counter[str]) -> Iterator[Timed]:
    """Scans and odometry with settled times, still in log order.

    Times are at most WINDOW behind the latest one before them. `counts` gets
    `clock_set_back`, `stamp_outlier` (scans whose stamp was replaced) and
    `odometry_stamp_outlier` (readings left out).
    """
    source = _stamped(records, clock)
    ahead = deque(islice(source, AHEAD + 1))
    offset = sequence = 0
    high = last = last_log = None
    before: tuple[int, Odometry] | None = None
    while ahead:
        raw_ns, record = ahead.popleft()
        ahead.extend(islice(source, 1))
        time_ns: int | None = raw_ns + offset
        value = record.value
        assert isinstance(value, (Scan, Odometry))
        assert time_ns is not None
        if high is None or last is None or last_log is None:
            sound = _sound_first(time_ns, [raw for raw, _ in ahead])
            if sound != time_ns:
                time_ns = None if isinstance(value, Odometry) else sound
        elif time_ns < high - WINDOW:
            if _most(raw + offset < high - WINDOW for raw, _ in ahead):
                pause = record.log_ns - last_log
                carried = last + (pause if 0 <= pause <= LEAP else 0)
                offset += carried - time_ns
                time_ns = carried
                counts["clock_set_back"] += 1
            else:
                time_ns = None if isinstance(value, Odometry) else last
        elif time_ns > high + LEAP and _most(
            high - WINDOW <= raw + offset <= high + LEAP for raw, _ in ahead
        ):
            time_ns = None if isinstance(value, Odometry) else last
        if time_ns is None:
            counts["odometry_stamp_outlier"] += 1
            continue
        if time_ns != raw_ns + offset:
            counts["stamp_outlier"] += 1
        if isinstance(value, Odometry):
            before = (raw_ns, value)
            own = None
        else:
            own = before[1] if before is not None and before[0] == raw_ns else None
            before = None
        high = time_ns if high is None else max(high, time_ns)
        last, last_log = time_ns, record.log_ns
        yield Timed(time_ns, sequence, value, record.log_ns, own)
        sequence += 1


def _sound_first(first: int, later: list[int]) -> int:
    """The log's first stamp; the first of those after it where it is far from them."""
    if not later or abs(first - median(later)) <= FAR:
        return first
    return next(raw for raw in later if abs(raw - median_low(later)) <= FAR)


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
