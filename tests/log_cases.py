"""One small recording, written in every format that hiermap reads.

The robot drives at a constant speed and turns at a constant rate, so that interpolated odometry
has the same digits in every format. ROS bags are written by rosbags and MCAP files by mcap;
Foxglove's messages and text logs are written here, by hand.
"""

from __future__ import annotations

import gzip
import math
from typing import TYPE_CHECKING, Any

import foxglove_cases as foxglove
import numpy as np
import yaml
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hiermap_cli.logs.records import LaserGeometry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

BEAMS = 180
SCANS = 24
SECOND = 1_000_000_000
START = 1_600_000_000 * SECOND
SCAN_STEP = SECOND // 5
ODOMETRY_STEP = SECOND // 8
FORWARD, TURN = 0.4, 0.2  # metres and radians a second
MOUNT_X = 0.25
REACH = 81.83

STORE1 = get_typestore(Stores.ROS1_NOETIC)
STORE2 = get_typestore(Stores.ROS2_HUMBLE)
STORE1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)


def laser() -> LaserGeometry:
    def single(value: float) -> float:
        return float(np.float32(value))

    return LaserGeometry(single(-0.5 * math.pi), single(math.pi / 180.0), BEAMS, 0.0, single(REACH))


def stamps() -> list[int]:
    return [START + (i + 1) * SCAN_STEP for i in range(SCANS)]


def pose(stamp_ns: int) -> tuple[float, float, float]:
    seconds = (stamp_ns - START) / SECOND
    return FORWARD * seconds, -0.1 * seconds, TURN * seconds - 0.5


def ranges(index: int) -> NDArray[np.float64]:
    """Metres with two decimals; some beams see nothing in reach, some say nothing."""
    beam = np.arange(BEAMS)
    out = np.round(2.0 + 0.01 * ((beam * 7 + index * 13) % 400), 2)
    out[(beam + index) % 17 == 3] = np.inf
    out[(beam + index) % 23 == 5] = np.nan
    return out


def odometry_stamps() -> list[int]:
    last = stamps()[-1]
    return list(range(START, last + ODOMETRY_STEP + 1, ODOMETRY_STEP))


Event = tuple[str, int, int]  # "odometry" or "scan", stamp, index


def events() -> list[Event]:
    """All messages in the order in which they were recorded."""
    out = [("scan", stamp, i) for i, stamp in enumerate(stamps())]
    out += [("odometry", stamp, i) for i, stamp in enumerate(odometry_stamps())]
    return sorted(out, key=lambda event: (event[1], event[0]))


def scan_message(store: Any, stamp_ns: int, index: int, seq: int = 0) -> Any:
    kinds = store.types
    geometry = laser()
    return kinds["sensor_msgs/msg/LaserScan"](
        header=header(store, stamp_ns, "laser", seq),
        angle_min=geometry.angle_min,
        angle_max=geometry.angle_min + (BEAMS - 1) * geometry.angle_increment,
        angle_increment=geometry.angle_increment,
        time_increment=0.0,
        scan_time=0.0,
        range_min=0.0,
        range_max=REACH,
        ranges=ranges(index).astype(np.float32),
        intensities=np.zeros(0, dtype=np.float32),
    )


def odometry_message(
    store: Any, stamp_ns: int, at: tuple[float, float, float], seq: int = 0, child: str = "base"
) -> Any:
    kinds = store.types
    x, y, theta = at
    vector = kinds["geometry_msgs/msg/Vector3"]
    position = kinds["geometry_msgs/msg/Point"](x=x, y=y, z=0.0)
    rotation = kinds["geometry_msgs/msg/Quaternion"](
        x=0.0, y=0.0, z=math.sin(theta / 2), w=math.cos(theta / 2)
    )
    twist = kinds["geometry_msgs/msg/Twist"](
        linear=vector(x=0.0, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0)
    )
    zeros = np.zeros(36)
    return kinds["nav_msgs/msg/Odometry"](
        header=header(store, stamp_ns, "odom", seq),
        child_frame_id=child,
        pose=kinds["geometry_msgs/msg/PoseWithCovariance"](
            pose=kinds["geometry_msgs/msg/Pose"](position=position, orientation=rotation),
            covariance=zeros,
        ),
        twist=kinds["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=zeros),
    )


def header(store: Any, stamp_ns: int, frame: str, seq: int = 0) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, SECOND)
    stamp = store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    more = {"seq": seq} if store is STORE1 else {}
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **more)


MOUNT_EDGES: tuple[foxglove.Edge, ...] = (
    ("base", "plate", (0.05, 0.0, 0.3), (0.0, 0.0, 0.0, 1.0)),
    ("plate", "laser", (MOUNT_X - 0.05, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0)),
)


def tf_message(store: Any, stamp_ns: int, edges: tuple[foxglove.Edge, ...]) -> Any:
    kinds = store.types
    transforms = []
    for parent, child, translation, rotation in edges:
        x, y, z = translation
        qx, qy, qz, qw = rotation
        transforms.append(
            kinds["geometry_msgs/msg/TransformStamped"](
                header=header(store, stamp_ns, parent),
                child_frame_id=child,
                transform=kinds["geometry_msgs/msg/Transform"](
                    translation=kinds["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
                    rotation=kinds["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
                ),
            )
        )
    return kinds["tf2_msgs/msg/TFMessage"](transforms=transforms)


def ros_messages(store: Any) -> Iterator[tuple[str, str, int, Any]]:
    """(topic, type, log time, message); the recorder writes each a moment after its stamp."""
    late = 3_000_000
    yield (
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        START + late,
        tf_message(store, START, MOUNT_EDGES),
    )
    for kind, stamp_ns, index in events():
        if kind == "scan":
            message = scan_message(store, stamp_ns, index, index)
            yield "/scan", "sensor_msgs/msg/LaserScan", stamp_ns + late, message
        else:
            message = odometry_message(store, stamp_ns, pose(stamp_ns), index)
            yield "/odom", "nav_msgs/msg/Odometry", stamp_ns + late, message


def write_ros2_mcap(
    path: Path,
    compression: CompressionType = CompressionType.ZSTD,
    *,
    chunked: bool = True,
    chunk_size: int = 4000,
    schemas: bool = True,
    finish: bool = True,
    data_crcs: bool = False,
) -> None:
    with path.open("wb") as file:
        writer = McapWriter(
            file,
            chunk_size=chunk_size,
            compression=compression,
            use_chunking=chunked,
            enable_data_crcs=data_crcs,
        )
        writer.start("ros2", "tests")
        channels: dict[str, int] = {}
        for topic, kind, log_ns, message in ros_messages(STORE2):
            if topic not in channels:
                text = STORE2.generate_msgdef(kind, ros_version=2)[0] if schemas else ""
                schema = writer.register_schema(kind, "ros2msg" if schemas else "", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(STORE2.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_ns, data, log_ns)
        if finish:
            writer.finish()


def write_ros1_mcap(path: Path) -> None:
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=4000, compression=CompressionType.LZ4)
        writer.start("ros1", "tests")
        channels: dict[str, int] = {}
        for topic, kind, log_ns, message in ros_messages(STORE1):
            if topic not in channels:
                name = kind.replace("/msg/", "/")
                text = STORE1.generate_msgdef(kind, ros_version=1)[0]
                schema = writer.register_schema(name, "ros1msg", text.encode())
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            data = bytes(STORE1.serialize_ros1(message, kind))
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()


def write_bag1(path: Path, compression: str = "") -> None:
    writer = Bag1Writer(path)
    writer.chunk_threshold = 4000
    if compression:
        writer.set_compression(Bag1Writer.CompressionFormat[compression.upper()])
    with writer:
        channels: dict[str, Any] = {}
        for topic, kind, log_ns, message in ros_messages(STORE1):
            if topic not in channels:
                channels[topic] = writer.add_connection(topic, kind, typestore=STORE1)
            writer.write(channels[topic], log_ns, bytes(STORE1.serialize_ros1(message, kind)))


def write_rosbag2(
    folder: Path,
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
    mode: CompressionMode = CompressionMode.NONE,
) -> None:
    writer = Bag2Writer(folder, version=8, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        channels: dict[str, Any] = {}
        for topic, kind, log_ns, message in ros_messages(STORE2):
            if topic not in channels:
                channels[topic] = writer.add_connection(topic, kind, typestore=STORE2)
            writer.write(channels[topic], log_ns, STORE2.serialize_cdr(message, kind))


def list_more(folder: Path, name: str) -> None:
    """Adds a file to those that a folder's metadata names."""
    document = yaml.safe_load((folder / "metadata.yaml").read_text())
    document["rosbag2_bagfile_information"]["relative_file_paths"].append(name)
    (folder / "metadata.yaml").write_text(yaml.safe_dump(document))


def write_foxglove_mcap(path: Path, encoding: str, *, poses: bool = False) -> None:
    """With `poses` odometry comes as PoseInFrame, else as a FrameTransform on /tf."""
    protobuf = encoding == "protobuf"
    scan = foxglove.protobuf_scan if protobuf else foxglove.json_scan
    transform = foxglove.protobuf_transform if protobuf else foxglove.json_transform
    place = foxglove.protobuf_pose if protobuf else foxglove.json_pose
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=4000)
        writer.start("", "tests")
        channels: dict[str, int] = {}

        def write(topic: str, kind: str, stamp_ns: int, data: bytes) -> None:
            if topic not in channels:
                schema = writer.register_schema(f"foxglove.{kind}", encoding, b"")
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], stamp_ns, data, stamp_ns)

        for edge in MOUNT_EDGES:
            write("/tf", "FrameTransform", START, transform(START, edge))
        for kind, stamp_ns, index in events():
            if kind == "scan":
                write("/laser", "LaserScan", stamp_ns, scan(stamp_ns, ranges(index).tolist()))
            elif poses:
                write("/pose", "PoseInFrame", stamp_ns, place(stamp_ns, pose(stamp_ns)))
            else:
                data = transform(stamp_ns, foxglove.odometry_edge(pose(stamp_ns)))
                write("/tf", "FrameTransform", stamp_ns, data)
        writer.finish()


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // SECOND}.{stamp_ns % SECOND // 1000:06d}"


def carmen_text(*, laser_record: str = "FLASER", param: bool = True) -> str:
    lines = ["# a CARMEN log", "SYNC start 0 host 0"]
    if param:
        lines.append(f"PARAM robot_frontlaser_offset {MOUNT_X} host 0")
    for kind, stamp_ns, index in events():
        x, y, theta = pose(stamp_ns)
        place = f"{x:.6f} {y:.6f} {theta:.6f}"
        end = f"{_seconds(stamp_ns)} host {_seconds(stamp_ns - START)}"
        if kind == "odometry":
            lines.append(f"ODOM {place} 0 0 0 {end}")
            continue
        values = " ".join(
            "81.91" if math.isinf(r) else "0.00" if math.isnan(r) else f"{r:.2f}"
            for r in ranges(index)
        )
        if laser_record in ("FLASER", "RLASER"):
            lines.append(f"{laser_record} {BEAMS} {values} {place} {place} {end}")
            continue
        head = f"0 {-math.pi / 2:.9f} {math.pi:.9f} {math.pi / 180:.9f} 81.9 0.01 0"
        body = f"{laser_record} {head} {BEAMS} {values} 0"
        if laser_record == "ROBOTLASER1":
            c, s = math.cos(theta), math.sin(theta)
            there = f"{x + MOUNT_X * c:.6f} {y + MOUNT_X * s:.6f} {theta:.6f}"
            body += f" {there} {place} 0 0 0 0 0"
        lines.append(f"{body} {end}")
    return "\n".join([*lines, "NEFF 30.5 0 host 0", ""])


def wean_text() -> str:
    lines = []
    for kind, stamp_ns, index in events():
        x, y, theta = pose(stamp_ns)
        c, s = math.cos(theta), math.sin(theta)
        place = f"{100 * x:.6f} {100 * y:.6f} {theta:.6f}"
        end = _seconds(stamp_ns)
        if kind == "odometry":
            lines.append(f"O {place} {end}")
            continue
        at = f"{100 * (x + MOUNT_X * c):.6f} {100 * (y + MOUNT_X * s):.6f} {theta:.6f}"
        values = " ".join(
            str(8183 + (i % 9)) if math.isinf(r) else "0" if math.isnan(r) else f"{100 * r:.0f}"
            for i, r in enumerate(ranges(index))
        )
        lines.append(f"L {place} {at} {values} {end}")
    return "\n".join([*lines, ""])


def _gzipped(text: str) -> bytes:
    return gzip.compress(text.encode(), mtime=0)


def _split_carmen(folder: Path) -> list[Path]:
    lines = carmen_text().splitlines(keepends=True)
    half = len(lines) // 2
    paths = [folder / "part_0.log", folder / "part_1.log.gz"]
    paths[0].write_text("".join(lines[:half]))
    paths[1].write_bytes(_gzipped("".join(lines[half:])))
    return paths


def _into(name: str, write: Callable[[Path], None]) -> Callable[[Path], list[Path]]:
    def build(folder: Path) -> list[Path]:
        write(folder / name)
        return [folder / name]

    return build


FORMATS: dict[str, Callable[[Path], list[Path]]] = {
    "mcap zstd": _into("log.mcap", write_ros2_mcap),
    "mcap lz4": _into("log.mcap", lambda p: write_ros2_mcap(p, CompressionType.LZ4)),
    "mcap plain": _into("log.mcap", lambda p: write_ros2_mcap(p, CompressionType.NONE)),
    "mcap unchunked": _into("log.mcap", lambda p: write_ros2_mcap(p, chunked=False)),
    "mcap without schemas": _into("log.mcap", lambda p: write_ros2_mcap(p, schemas=False)),
    "mcap ros1": _into("log.mcap", write_ros1_mcap),
    "mcap protobuf": _into("log.mcap", lambda p: write_foxglove_mcap(p, "protobuf")),
    "mcap protobuf poses": _into(
        "log.mcap", lambda p: write_foxglove_mcap(p, "protobuf", poses=True)
    ),
    "mcap json": _into("log.mcap", lambda p: write_foxglove_mcap(p, "json")),
    "mcap json poses": _into("log.mcap", lambda p: write_foxglove_mcap(p, "json", poses=True)),
    "bag": _into("log.bag", write_bag1),
    "bag bz2": _into("log.bag", lambda p: write_bag1(p, "bz2")),
    "bag lz4": _into("log.bag", lambda p: write_bag1(p, "lz4")),
    "rosbag2": _into("bag", write_rosbag2),
    "rosbag2 mcap": _into("bag", lambda p: write_rosbag2(p, StoragePlugin.MCAP)),
    "rosbag2 file zstd": _into("bag", lambda p: write_rosbag2(p, mode=CompressionMode.FILE)),
    "rosbag2 message zstd": _into("bag", lambda p: write_rosbag2(p, mode=CompressionMode.MESSAGE)),
    "carmen": _into("log.carmen", lambda p: p.write_text(carmen_text())),
    "carmen gzip": _into("log.carmen.gz", lambda p: p.write_bytes(_gzipped(carmen_text()))),
    "carmen ROBOTLASER1": _into(
        "log.log", lambda p: p.write_text(carmen_text(laser_record="ROBOTLASER1", param=False))
    ),
    "carmen RAWLASER1": _into(
        "log.log", lambda p: p.write_text(carmen_text(laser_record="RAWLASER1"))
    ),
    "carmen split": _split_carmen,
    "wean": _into("log.log", lambda p: p.write_text(wean_text())),
    "wean gzip": _into("log.log.gz", lambda p: p.write_bytes(_gzipped(wean_text()))),
}
