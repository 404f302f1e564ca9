"""Whether files can be parts of one recording, and where one of them follows another.

A recorder that splits its files may write a few messages twice, two recorders may have run side by
side, and scans and odometry may be in files of their own: all that is one recording. Two robots,
or two drives, are none; joined, they would give a map of neither. What tells them apart: a robot
is in one place at a time, and one topic has one laser on one mount. Where files follow each other
without overlapping, odometry tells nothing for certain: it may have been set back, or the robot
carried. There a jump is worth a warning (`seams`).
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.errors import InputError
from hiermap_cli.logs.clock import SECOND, Clock, choose_clock
from hiermap_cli.logs.decimals import ns_to_seconds
from hiermap_cli.logs.join import plausible, sound_geometry
from hiermap_cli.logs.records import Odometry, Scan, Transform
from hiermap_cli.logs.seams import Seam
from hiermap_cli.logs.survey import Plan, odometry_of
from hiermap_cli.logs.transforms import FrameTree, frame_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hiermap_cli.logs.records import LaserGeometry, Mount, Record
    from hiermap_cli.logs.source import Part, Source

    Stamps = NDArray[np.int64]
    Poses = NDArray[np.float64]

_AROUND = SECOND // 10  # two recorders, or a late stamp, tell the same reading so far apart
_GAP = 1 * SECOND  # readings farther apart do not say where the robot was between them
_ROOM = (0.02, 0.02)  # metres and radians beyond the way between two readings
_FEWEST, _SHARE = 3, 0.05  # readings that contradict before anything is said: single ones may lie
_HEAD = 32  # scans of a part that show its laser
_LAST = 1 << 62  # ns; a stamp beyond is a damaged number
_MOUNT_APART = (0.02, 0.02)  # metres, radians


class _Track(NamedTuple):
    """A part's odometry by time: stamps_ns (N,), poses (N, 3)."""

    stamps_ns: Stamps
    poses: Poses


class _Readings(NamedTuple):
    """A part's odometry as recorded: headers_ns (N,), logs_ns (N,), poses (N, 3), its clock."""

    headers_ns: Stamps
    logs_ns: Stamps
    poses: Poses
    clock: Clock

    def track(self, clock: Clock) -> _Track:
        """By one of the two clocks."""
        stamps_ns = self.headers_ns if clock == "header" else self.logs_ns
        order = np.argsort(stamps_ns, kind="stable")
        return _Track(stamps_ns[order], self.poses[order])


class _Laser(NamedTuple):
    """A part's laser: frames and geometries of its first scans, and its mount if the part says."""

    frames: frozenset[str]
    geometries: frozenset[LaserGeometry]
    mount: Mount | None


def check_parts(source: Source, plan: Plan) -> tuple[Seam, ...]:
    """The seams between files that follow each other, in the order of the recording.

    Raises InputError where files of a recording contradict each other. Only files that overlap in
    time are read, of the others their beginnings. Each file's own stamps say whether they are
    usable, for two logs mixed with each other may look as if neither clock went forward.
    """
    parts = source.parts()
    readings: dict[int, _Readings] = {}
    lasers = [_laser(part.source, plan) for part in parts]
    overlapping: set[int] = set()  # parts that overlap one before them
    for pair in combinations(range(len(parts)), 2):
        first, second = (parts[i] for i in pair)
        found, overlap, told_twice = None, False, False
        if _may_overlap(first, second):
            for i in pair:
                if i not in readings:
                    readings[i] = _read(parts[i].source, plan)
            clocks = {readings[i].clock for i in pair}
            if "order" not in clocks:
                clock: Clock = "log" if "log" in clocks else "header"
                one, other = (readings[i].track(clock) for i in pair)
                overlap = first.span is not None or _same_time(one, other)
                # Both ways, for the readings of one of them may be few.
                found = _contradiction(one, other) or _contradiction(other, one)
                told_twice = bool(_told_twice(one, other).any())
        if overlap:
            overlapping.add(pair[1])
        found = found or _other_laser(lasers[pair[0]], lasers[pair[1]], plan, told_twice=told_twice)
        if found:
            names = " and ".join(str(part.source.paths[0]) for part in (first, second))
            how = "overlap in time and " if overlap else ""
            raise InputError(
                f"{names} {how}are no parts of one recording: {found}; give them one at a time"
            )
    return _seams(parts, overlapping, plan)


def _seams(parts: list[Part], overlapping: set[int], plan: Plan) -> tuple[Seam, ...]:
    """Between the parts that overlap none before them, and have odometry, and those before."""
    out: list[Seam] = []
    before: Part | None = None
    for number, part in enumerate(parts):
        first = next(_odometry(part.source, plan), None)
        if first is None:
            continue
        if before is not None and number not in overlapping:
            reading = first.value
            assert isinstance(reading, Odometry)
            out.append(Seam(_name(before), _name(part), reading, first.log_ns))
        before = part
    return tuple(out)


def _name(part: Part) -> str:
    return part.source.paths[0].name


def _may_overlap(first: Part, second: Part) -> bool:
    if first.span is None or second.span is None:
        return True
    (begin, end), (other_begin, other_end) = first.span, second.span
    return bool(end and other_end) and begin <= other_end and other_begin <= end


def _read(source: Source, plan: Plan) -> _Readings:
    """The chosen odometry of a part; headings not wrapped."""
    stamps: list[tuple[int, int]] = []
    poses: list[tuple[float, float, float]] = []
    for record in _odometry(source, plan):
        value = record.value
        assert isinstance(value, Odometry)
        stamps.append((value.stamp_ns, record.log_ns))
        poses.append((value.x, value.y, value.theta))
    headers_ns, logs_ns = np.array(stamps, dtype=np.int64).reshape(-1, 2).T
    clock = choose_clock(stamps) if stamps else "header"
    return _Readings(headers_ns, logs_ns, np.array(poses).reshape(-1, 3), clock)


def _odometry(source: Source, plan: Plan) -> Iterator[Record]:
    """The sound readings of a part's chosen odometry."""
    for record in odometry_of(source.records(plan.odometry.topics), plan.odometry):
        value = record.value
        if (
            isinstance(value, Odometry)
            and record.topic in plan.odometry.topics
            and plausible(value)
            and max(abs(value.stamp_ns), abs(record.log_ns)) < _LAST
        ):
            yield record


def _contradiction(first: _Track, second: _Track) -> str | None:
    """What the readings of the second part say against those of the first, None if nothing."""
    if len(first.stamps_ns) < 2 or not len(second.stamps_ns):
        return None
    at_ns = second.stamps_ns
    before = np.searchsorted(first.stamps_ns, at_ns - _AROUND, side="right") - 1
    after = np.searchsorted(first.stamps_ns, at_ns + _AROUND, side="left")
    inside = (before >= 0) & (after < len(first.stamps_ns))
    before, after = np.maximum(before, 0), np.minimum(after, len(first.stamps_ns) - 1)
    near = inside & (first.stamps_ns[after] - first.stamps_ns[before] <= 2 * _AROUND + _GAP)
    to, way = (p - first.poses[before] for p in (second.poses, first.poses[after]))
    apart = (np.hypot(to[:, 0], to[:, 1]) > np.hypot(way[:, 0], way[:, 1]) + _ROOM[0]) | (
        np.abs(_wrapped(to[:, 2])) > np.abs(_wrapped(way[:, 2])) + _ROOM[1]
    )
    against = near & apart & ~_told_twice(first, second)
    if against.sum() < max(_FEWEST, _SHARE * near.sum()):
        return None
    # The worst reading shows it best.
    worst = int(np.argmax(np.where(against, np.hypot(to[:, 0], to[:, 1]), -1.0)))
    one, other = first.poses[before[worst]], second.poses[worst]
    return (
        f"at {ns_to_seconds(int(at_ns[worst]))} s odometry is at {_place(one)} in one and at "
        f"{_place(other)} in the other"
    )


def _told_twice(first: _Track, second: _Track) -> NDArray[np.bool_]:
    """Which readings of the second part are in the first, too: (N,)."""
    told = set(zip(first.stamps_ns.tolist(), map(tuple, first.poses.tolist()), strict=True))
    ours = zip(second.stamps_ns.tolist(), map(tuple, second.poses.tolist()), strict=True)
    return np.array([reading in told for reading in ours], dtype=np.bool_)


def _other_laser(one: _Laser, other: _Laser, plan: Plan, *, told_twice: bool) -> str | None:
    """How the scans of two parts show two lasers, None if they do not.

    told_twice: whether the parts have readings of odometry in common.
    """
    if not (one.geometries and other.geometries):
        return None
    if one.frames and other.frames and not one.frames & other.frames:
        names = f"{_listed(one.frames)} and {_listed(other.frames)}"
        return f"the scans on {plan.scan_topic} are of the frames {names}"
    if not any(_alike(a, b) for a in one.geometries for b in other.geometries):
        shapes = " and ".join(_shape(min(laser.geometries)) for laser in (one, other))
        return f"the scans on {plan.scan_topic} have {shapes}"
    if (
        plan.mount_source != "configuration"
        and one.mount is not None
        and other.mount is not None
        and _apart(one.mount, other.mount)
        and not told_twice
    ):
        mounts = f"{_mount_text(one.mount)} and {_mount_text(other.mount)}"
        return f"the laser is mounted at {mounts}"
    return None


def _laser(source: Source, plan: Plan) -> _Laser:
    scans: list[Scan] = []
    told: list[Transform] = []
    for record in source.records(frozenset({plan.scan_topic})):
        if isinstance(record.value, Scan):
            scans.append(record.value)
        elif isinstance(record.value, Transform):
            told.append(record.value)
        if len(scans) >= _HEAD:
            break
    tree = FrameTree(source.static_transforms()).joined(FrameTree(told).without_moving())
    found = tree.mount(plan.base_frame, plan.laser_frame)
    return _Laser(
        frozenset(frame_name(scan.frame) for scan in scans if scan.frame),
        frozenset(scan.laser for scan in scans if sound_geometry(scan.laser)),
        found.mount if found is not None else None,
    )


def _same_time(first: _Track, second: _Track) -> bool:
    a, b = first.stamps_ns, second.stamps_ns
    return bool(len(a) and len(b) and a[0] <= b[-1] and b[0] <= a[-1])


def _alike(a: LaserGeometry, b: LaserGeometry) -> bool:
    """One laser: counts of beams may change from scan to scan, their directions hardly."""
    step = abs(a.angle_increment)
    return (
        abs(a.angle_min - b.angle_min) < 0.05 + 2.0 * step
        and abs(a.angle_increment - b.angle_increment) < 0.1 * step
    )


def _apart(a: Mount, b: Mount) -> bool:
    turn = abs(math.remainder(a.yaw - b.yaw, 2.0 * math.pi))
    return (
        a.flipped != b.flipped
        or math.hypot(a.x - b.x, a.y - b.y) > _MOUNT_APART[0]
        or turn > _MOUNT_APART[1]
    )


def _wrapped(angles: Poses) -> Poses:
    return np.remainder(angles + math.pi, 2.0 * math.pi) - math.pi


def _place(pose: Poses) -> str:
    turn = math.degrees(math.remainder(pose[2], 2.0 * math.pi))
    return f"({pose[0]:.2f}, {pose[1]:.2f}, {turn:.0f} deg)"


def _listed(names: frozenset[str]) -> str:
    return ", ".join(sorted(names))


def _shape(laser: LaserGeometry) -> str:
    return f"{laser.beams} beams from {math.degrees(laser.angle_min):.0f} degrees"


def _mount_text(mount: Mount) -> str:
    text = f"{mount.x:.2f},{mount.y:.2f},{mount.yaw:.2f}"
    return text + (",flipped" if mount.flipped else "")
