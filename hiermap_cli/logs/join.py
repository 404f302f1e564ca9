"""Scans joined with odometry: interpolation to each scan's stamp, and blocks of scans."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.logs.records import LaserGeometry, Odometry, Scan, ScanBlock

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from hiermap_cli.logs.clock import Timed
    from hiermap_cli.logs.records import Mount

    Pose = tuple[float, float, float]

PENDING = 2048  # scans that wait for an odometry reading after them
FARTHEST = 1e7  # metres; odometry beyond is a damaged number

_TURN = 2.0 * math.pi
_REPEATS = 8  # a block has at most so many times its size, however many scans are repeated


class JoinedScan(NamedTuple):
    """A scan at its settled time with the robot's pose in the odometry's frame."""

    time_ns: int
    scan: Scan
    pose: Pose
    has_odometry: bool
    repeated: bool = False


def join(records: Iterable[Timed], first: Odometry, counts: Counter[str]) -> Iterator[JoinedScan]:
    """Every scan of `records`, which are in time order, with its odometry.

    A scan's own reading counts before all others; else the pose is interpolated between the
    readings around it, linearly and along the shortest arc. Scans before the first reading have
    `first`, those after the last one, or PENDING scans before the next, the last. `counts` gets
    `odometry` (readings used) and, of the scans, `before_first_odometry`,
    `after_last_odometry` and `odometry_missing`.
    """
    before: tuple[int, Pose] | None = None
    pending: deque[Timed] = deque()
    start = wrapped(first.x, first.y, first.theta)
    for timed in records:
        value = timed.value
        if isinstance(value, Odometry):
            if not plausible(value):
                counts["odometry_not_finite"] += 1
                continue
            counts["odometry"] += 1
            after = (timed.time_ns, wrapped(value.x, value.y, value.theta))
            while pending:
                yield _between(pending.popleft(), before, after, start, counts)
            before = after
            continue
        pending.append(timed)
        if len(pending) > PENDING:
            reason = "odometry_missing" if before is not None else "before_first_odometry"
            yield _held(pending.popleft(), before, start, counts, reason)
    while pending:
        reason = "after_last_odometry" if before is not None else "before_first_odometry"
        yield _held(pending.popleft(), before, start, counts, reason)


def wrapped(x: float, y: float, theta: float) -> Pose:
    """The pose with its heading in (-pi, pi]."""
    theta = math.remainder(theta, _TURN)
    return x, y, math.pi if theta == -math.pi else theta


def plausible(reading: Odometry) -> bool:
    """Whether the numbers can be a pose at all."""
    return abs(reading.x) < FARTHEST and abs(reading.y) < FARTHEST and abs(reading.theta) < FARTHEST


def _own(timed: Timed) -> Pose | None:
    own = timed.own
    return wrapped(own.x, own.y, own.theta) if own is not None and plausible(own) else None


def _between(
    timed: Timed,
    before: tuple[int, Pose] | None,
    after: tuple[int, Pose],
    start: Pose,
    counts: Counter[str],
) -> JoinedScan:
    time_ns, scan = timed.time_ns, timed.value
    assert isinstance(scan, Scan)
    own = _own(timed)
    if own is not None:
        return JoinedScan(time_ns, scan, own, has_odometry=True)
    if before is None:
        if time_ns < after[0]:
            return _held(timed, None, start, counts, "before_first_odometry")
        return JoinedScan(time_ns, scan, after[1], has_odometry=True)
    (t0, (x0, y0, theta0)), (t1, (x1, y1, theta1)) = before, after
    if time_ns <= t0:
        return JoinedScan(time_ns, scan, before[1], has_odometry=True)
    f = (time_ns - t0) / (t1 - t0)
    turn = math.remainder(theta1 - theta0, _TURN)
    pose = wrapped(x0 + f * (x1 - x0), y0 + f * (y1 - y0), theta0 + f * turn)
    return JoinedScan(time_ns, scan, pose, has_odometry=True)


def _held(
    timed: Timed,
    before: tuple[int, Pose] | None,
    start: Pose,
    counts: Counter[str],
    reason: str,
) -> JoinedScan:
    scan = timed.value
    assert isinstance(scan, Scan)
    own = _own(timed)
    if own is not None:
        return JoinedScan(timed.time_ns, scan, own, has_odometry=True)
    if before is not None and timed.time_ns == before[0]:
        return JoinedScan(timed.time_ns, scan, before[1], has_odometry=True)
    counts[reason] += 1
    pose, known = (before[1], True) if before is not None else (start, False)
    return JoinedScan(timed.time_ns, scan, pose, has_odometry=known)


def sound_geometry(laser: LaserGeometry) -> bool:
    """Whether beams have directions: some beams, finite angles, at most one turn and a bit."""
    return (
        laser.beams > 0
        and math.isfinite(laser.angle_min)
        and abs(laser.angle_min) <= 2.0 * _TURN
        and 0.0 < abs(laser.angle_increment) < _TURN
        and abs(laser.angle_increment) * (laser.beams - 1) < 1.1 * _TURN
    )


def in_blocks(
    scans: Iterable[JoinedScan],
    mount: Mount,
    first: LaserGeometry,
    size: int,
    counts: Counter[str],
) -> Iterator[ScanBlock]:
    """Blocks of at most `size` successive scans of one geometry, repeated ones not counted.

    A scan without beams, or whose angles are nonsense, has the geometry of the scan before it
    (`first` at the beginning) and says nothing. `counts` gets `scans` and, of these,
    `repeated_stamp` and of these `repeated_scan`, `no_beams` and `no_valid_range`.
    """
    block: list[JoinedScan] = []
    laser = first
    previous: JoinedScan | None = None
    new = 0
    for joined in scans:
        counts["scans"] += 1
        if previous is not None and joined.time_ns == previous.time_ns:
            counts["repeated_stamp"] += 1
            if _same_scan(joined.scan, previous.scan):
                counts["repeated_scan"] += 1
                joined = joined._replace(repeated=True)  # noqa: PLW2901
        previous = joined
        own = joined.scan.laser
        if not sound_geometry(own):
            counts["no_beams"] += 1
            silent = np.full(laser.beams, np.nan, dtype=np.float32)
            joined = joined._replace(scan=Scan(joined.scan.stamp_ns, silent, laser))  # noqa: PLW2901
        elif own != laser:
            if block:
                yield _block(block, laser, mount, counts)
                block, new = [], 0
            laser = own
        block.append(joined)
        new += not joined.repeated
        # So that what is new comes in the same blocks with and without repeats.
        if new == size or len(block) == _REPEATS * size:
            yield _block(block, laser, mount, counts)
            block, new = [], 0
    if block:
        yield _block(block, laser, mount, counts)


def _same_scan(a: Scan, b: Scan) -> bool:
    return a.laser == b.laser and np.array_equal(a.ranges, b.ranges, equal_nan=True)


def _block(
    scans: list[JoinedScan], laser: LaserGeometry, mount: Mount, counts: Counter[str]
) -> ScanBlock:
    ranges = np.array([joined.scan.ranges for joined in scans], dtype=np.float32)
    counts["no_valid_range"] += int((~np.isfinite(ranges).any(axis=1)).sum())
    block = ScanBlock(
        stamps_ns=np.array([joined.time_ns for joined in scans], dtype=np.int64),
        ranges=ranges,
        odometry=np.array([joined.pose for joined in scans], dtype=np.float64),
        has_odometry=np.array([joined.has_odometry for joined in scans], dtype=np.bool_),
        laser=laser,
        mount=mount,
        repeated=_repeated(scans),
    )
    for array in (block.stamps_ns, block.ranges, block.odometry, block.has_odometry):
        array.flags.writeable = False
    return block


def _repeated(scans: list[JoinedScan]) -> NDArray[np.bool_] | None:
    if not any(joined.repeated for joined in scans):
        return None
    repeated = np.array([joined.repeated for joined in scans], dtype=np.bool_)
    repeated.flags.writeable = False
    return repeated
