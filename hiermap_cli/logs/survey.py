"""The plan of a run, from the first part of a log: topics, mount, clock, first values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.errors import InputError
from hiermap_cli.logs.choice import (
    ARROW,
    EDGE,
    OdometryChoice,
    choose_odometry,
    choose_scans,
    describe,
)
from hiermap_cli.logs.clock import SECOND, Clock, choose_clock
from hiermap_cli.logs.head import Head, frame_trees, is_odometry_edge, read_head
from hiermap_cli.logs.join import plausible, sound_geometry
from hiermap_cli.logs.records import LaserGeometry, Mount, Odometry, Record, Scan, Transform
from hiermap_cli.logs.transforms import FrameTree, frame_name, planar_pose

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from hiermap_cli.config import InputConfig, MountConfig
    from hiermap_cli.logs.source import Source

    Edge = tuple[str, str]

BASE_FRAMES = ("base_link", "base_footprint", "base", "base_frame", "robot", "chassis")
REAR = math.radians(120.0)  # a mount's yaw beyond which the laser looks to the rear
FAR_MOUNT = 3.0  # metres
FARTHEST_RANGE = 500.0  # metres
DISAGREEMENT = 1 * SECOND  # between the header clocks of scans and odometry


class Plan(NamedTuple):
    """What a run reads, and how."""

    scan_topic: str
    odometry: OdometryChoice
    clock: Clock
    mount: Mount
    mount_source: str
    base_frame: str
    laser_frame: str
    first_odometry: Odometry
    first_laser: LaserGeometry
    warnings: tuple[str, ...]


def make_plan(source: Source, log: str, options: InputConfig) -> Plan:
    """Decides everything that must be known before the first block.

    Raises InputError where scans or odometry are missing, or more than one topic fits.
    """
    topics = source.topics()
    try:
        scans = choose_scans(log, topics, options.scan_topic)
        odometry = choose_odometry(log, topics, scans, options.odometry_topic)
    except InputError as error:
        raise InputError(f"{error}{_losses(source)}") from error
    head = read_head(source, scans.name, odometry)
    if not head.scans:
        raise InputError(f"{log}: no scan on {scans.name} can be read{_losses(source)}")
    warnings: list[str] = []
    scan_frame = head.scan_frame()
    static, steady = frame_trees(source, head, warnings)
    if odometry.from_transforms:
        odometry = _choose_edge(log, odometry, head, static)
    readings = list(odometry_of([*head.odometry, *head.moving], odometry))
    first = next((r.value for r in readings if _is_reading(r.value)), None)
    if first is None:
        raise InputError(
            f"{log}: no odometry on {odometry.name} can be read{_losses(source)}; "
            f"the log has {describe(topics)}"
        )
    assert isinstance(first, Odometry)
    if len(head.scans) > 1 and sum(_is_reading(r.value) for r in readings) < 2:
        # The head has fewer than HEAD readings only where the log has no more.
        raise InputError(
            f"{log}: a single reading of odometry on {odometry.name}{_losses(source)}: it does not "
            f"say how the robot moves; the log has {describe(topics)}"
        )
    base = frame_name(first.child) or _base_frame(steady, scan_frame)
    mount, mount_source = _mount(options.mount, (static, steady), base, scan_frame, warnings)
    laser = _first_laser(log, scans.name, head)
    warnings += _mount_warnings(mount, laser)
    return Plan(
        scans.name,
        odometry,
        _choose_clock(head.scans, readings, warnings),
        mount,
        mount_source,
        base,
        scan_frame,
        first,
        laser,
        tuple(warnings),
    )


def _first_laser(log: str, topic: str, head: Head) -> LaserGeometry:
    """The geometry of the first scan that has one. Raises InputError where none has."""
    seen = [r.value.laser for r in head.scans if isinstance(r.value, Scan)]
    sound = next((laser for laser in seen if sound_geometry(laser)), None)
    if sound is not None:
        return sound
    if not any(laser.beams for laser in seen):
        raise InputError(f"{log}: the scans on {topic} are empty")
    start, step = seen[0].angle_min, seen[0].angle_increment
    hint = ": are these degrees?" if abs(start) > 7.0 or abs(step) > 0.2 else ""
    raise InputError(
        f"{log}: the angles of the scans on {topic} make no sense (from {start:g} by {step:g} "
        f"radians a beam){hint}"
    )


def odometry_of(records: Iterable[Record], choice: OdometryChoice) -> Iterator[Record]:
    """The records with the chosen edge's transforms turned into odometry, others left out."""
    for record in records:
        value = record.value
        if not isinstance(value, Transform):
            yield record
        elif (frame_name(value.parent), frame_name(value.child)) == choice.edge:
            x, y, theta = planar_pose(value.translation, value.rotation)
            reading = Odometry(value.stamp_ns, x, y, theta, value.parent, value.child)
            yield record._replace(value=reading)


def _is_reading(value: object) -> bool:
    return isinstance(value, Odometry) and plausible(value)


def _losses(source: Source) -> str:
    return f" ({source.losses[0]})" if source.losses else ""


def _choose_edge(
    log: str, odometry: OdometryChoice, head: Head, static: FrameTree
) -> OdometryChoice:
    """The edge odometry -> robot among the transforms. Raises InputError where two fit."""
    edges = (r.value for r in head.moving if isinstance(r.value, Transform))
    seen = list(dict.fromkeys((frame_name(e.parent), frame_name(e.child)) for e in edges))
    topic = odometry.name
    if odometry.edge is not None:
        if odometry.edge not in seen:
            raise InputError(
                f"{log}: no transform {ARROW.join(odometry.edge)} on {topic}; "
                f"there: {_edge_list(topic, seen)}"
            )
        return odometry._replace(name=topic + EDGE + ARROW.join(odometry.edge))
    scan_frame = head.scan_frame()
    fitting = [e for e in seen if is_odometry_edge(e, None)]
    if not fitting:
        fitting = [e for e in seen if static.connects(e[1], scan_frame)]
    fitting = _narrowed(fitting, lambda e: e[0].rpartition("/")[2] != "map")
    fitting = _narrowed(fitting, lambda e: static.connects(e[1], scan_frame))
    fitting = _narrowed(fitting, lambda e: e[1].rpartition("/")[2] in BASE_FRAMES)
    if len(fitting) != 1:
        what = f"{len(fitting)} transforms fit" if fitting else "no transform fits"
        raise InputError(
            f"{log}: no odometry topic, and {what} as odometry: "
            f"{_edge_list(topic, fitting or seen)}; choose one by --odom-topic"
        )
    return odometry._replace(name=topic + EDGE + ARROW.join(fitting[0]), edge=fitting[0])


def _narrowed(edges: list[Edge], fits: Callable[[Edge], bool]) -> list[Edge]:
    """Those that fit, or all where none does."""
    return [edge for edge in edges if fits(edge)] or edges


def _edge_list(topic: str, edges: Iterable[tuple[str, str]]) -> str:
    return ", ".join(topic + EDGE + ARROW.join(edge) for edge in edges) or "none"


def _base_frame(tree: FrameTree, scan_frame: str) -> str:
    """The robot's frame where the odometry does not name it."""
    for name in BASE_FRAMES:
        if name in tree.frames() and tree.connects(name, scan_frame):
            return name
    return BASE_FRAMES[0]


def _mount(
    given: MountConfig | None,
    trees: tuple[FrameTree, FrameTree],
    base: str,
    scan_frame: str,
    warnings: list[str],
) -> tuple[Mount, str]:
    if given is not None:
        return Mount(given.x, given.y, given.yaw, given.flipped), "configuration"
    for tree, remark in zip(trees, ("", ", a transform that stays the same"), strict=True):
        found = tree.mount(base, scan_frame)
        if found is not None:
            warnings.extend(found.warnings)
            return found.mount, f"log: {base} -> {scan_frame}{remark}"
    warnings.append(
        f"the log does not say where the laser is mounted ({base or 'robot'} -> "
        f"{scan_frame or 'laser'}): taken as the robot's own origin; give --mount x,y,yaw"
    )
    return Mount(), "assumed"


def _mount_warnings(mount: Mount, laser: LaserGeometry) -> list[str]:
    """What is unusual, and right only if the log or the configuration is."""
    out = []
    if abs(math.remainder(mount.yaw, 2.0 * math.pi)) > REAR:
        out.append(f"the laser looks to the rear: mount yaw {math.degrees(mount.yaw):.0f} degrees")
    if mount.flipped:
        out.append("the laser is mounted upside down: its scans are mirrored")
    elif laser.angle_increment < 0:
        out.append("the laser's beams run clockwise: its angle increment is negative")
    if math.hypot(mount.x, mount.y) > FAR_MOUNT:
        out.append(
            f"the laser is {math.hypot(mount.x, mount.y):.1f} m from the robot's origin: are "
            "these centimetres?"
        )
    if laser.range_max > FARTHEST_RANGE:
        out.append(f"the laser's stated reach is {laser.range_max:.0f} m: are these centimetres?")
    return out


def _choose_clock(scans: list[Record], readings: list[Record], warnings: list[str]) -> Clock:
    pairs = [
        [(r.value.stamp_ns, r.log_ns) for r in records if isinstance(r.value, (Scan, Odometry))]
        for records in (scans, readings)
    ]
    clocks = [choose_clock(p) for p in pairs if p]
    if "order" in clocks:
        warnings.append("stamps are unusable: the order of records is taken as their time")
        return "order"
    if "log" in clocks:
        warnings.append("header stamps are unusable: the recorder's time is taken instead")
        return "log"
    late = [sorted(header - log for header, log in p)[len(p) // 2] for p in pairs if p]
    apart = math.fabs(late[0] - late[-1])
    if apart > DISAGREEMENT and all(log for p in pairs for _, log in p):
        warnings.append(
            f"the header clocks of scans and odometry are {apart / SECOND:.1f} s apart: the "
            "recorder's time is taken instead"
        )
        return "log"
    return "header"
