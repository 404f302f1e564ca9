"""A log written as a ROS 2 MCAP: /scan, /odom and, for the mount, /tf_static."""

from __future__ import annotations

import math
import os
import secrets
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Self

from hiermap_cli import __version__
from hiermap_cli.errors import HiermapError, InputError, UsageError, output_error
from hiermap_cli.logs import cdr_write, ros_definitions
from hiermap_cli.logs.records import Mount, Transform

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    import numpy as np
    from mcap.writer import Writer
    from numpy.typing import ArrayLike, NDArray

    from hiermap_cli.logs.records import LaserGeometry

WRITER = "hiermap"  # by which a file that this program wrote is known
SCAN_TOPIC, ODOMETRY_TOPIC, STATIC_TOPIC = "/scan", "/odom", "/tf_static"
ODOMETRY_FRAME, BASE_FRAME, LASER_FRAME = "odom", "base_link", "laser"

# Transient local: a subscriber that comes late gets the static transforms too.
_STATIC_QOS = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
    "  deadline:\n    sec: 0\n    nsec: 0\n  lifespan:\n    sec: 0\n    nsec: 0\n"
    "  liveliness: 1\n  liveliness_lease_duration:\n    sec: 0\n    nsec: 0\n"
    "  avoid_ros_namespace_conventions: false\n"
)


class RosMcapWriter:
    """Writes messages in the order given; the file appears when the `with` block ends well.

    The same messages give the same bytes. `mount` None leaves /tf_static out.

    Raises:
        UsageError: the file exists and may not be replaced, or cannot be written there.
        OutputError: the disk is full or fails.
        InputError: a stamp does not fit into a ROS header.
    """

    def __init__(self, path: Path | str, mount: Mount | None, *, overwrite: bool = False) -> None:
        self._path = Path(path)
        self._mount = mount
        self._overwrite = overwrite
        self._part = self._path.with_name(f".{self._path.name}.{secrets.token_hex(4)}.part")
        self._file: BinaryIO | None = None
        self._writer: Writer | None = None
        self._channels: dict[str, int] = {}

    def __enter__(self) -> Self:
        from mcap.writer import Writer

        self._check_free()
        try:
            self._file = self._part.open("xb")
        except OSError as error:
            raise self._refused(error) from error
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library=f"{WRITER} {__version__}")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._file is not None
        assert self._writer is not None
        try:
            if kind is None:
                self._static(0)
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
                os.fsync(self._file.fileno())
                self._file.close()
                self._check_free()
                self._part.replace(self._path)
        except OSError as refused:
            raise self._refused(refused) from refused
        finally:
            with suppress(OSError):
                self._file.close()
            self._part.unlink(missing_ok=True)

    def scan(
        self,
        stamp_ns: int,
        ranges: ArrayLike,
        laser: LaserGeometry,
        *,
        log_ns: int | None = None,
    ) -> None:
        """One scan: ranges (beams,) in metres, +inf nothing in reach, nan says nothing."""
        data = cdr_write.laser_scan(stamp_ns, LASER_FRAME, ranges, laser)
        self._message(SCAN_TOPIC, ros_definitions.LASER_SCAN, stamp_ns, data, log_ns)

    def odometry(
        self,
        stamp_ns: int,
        pose: Sequence[float] | NDArray[np.float64],
        covariance: ArrayLike | None = None,
        *,
        log_ns: int | None = None,
    ) -> None:
        """One odometry reading: pose `[x, y, theta]` and, where known, its covariance (3, 3)."""
        data = cdr_write.odometry(stamp_ns, ODOMETRY_FRAME, BASE_FRAME, pose, covariance)
        self._message(ODOMETRY_TOPIC, ros_definitions.ODOMETRY, stamp_ns, data, log_ns)

    def _static(self, stamp_ns: int) -> None:
        """The mount, before the first message."""
        mount, self._mount = self._mount, None
        if mount is not None:
            edge = mount_transform(stamp_ns, mount)
            data = cdr_write.tf_message([edge])
            self._message(STATIC_TOPIC, ros_definitions.TF_MESSAGE, stamp_ns, data, None)

    def _message(
        self, topic: str, message_type: str, stamp_ns: int, data: bytes, log_ns: int | None
    ) -> None:
        assert self._writer is not None
        self._static(stamp_ns)
        log_ns = stamp_ns if log_ns is None else log_ns
        if not (0 <= log_ns < 1 << 64):
            raise InputError(f"stamp {log_ns} ns does not fit into an MCAP file")
        try:
            self._writer.add_message(
                self._channel(topic, message_type), log_ns, data, publish_time=log_ns
            )
        except OSError as error:
            raise self._refused(error) from error

    def _channel(self, topic: str, message_type: str) -> int:
        if topic not in self._channels:
            assert self._writer is not None
            definition = ros_definitions.DEFINITIONS[message_type].encode()
            schema = self._writer.register_schema(message_type, "ros2msg", definition)
            qos = {"offered_qos_profiles": _STATIC_QOS} if topic == STATIC_TOPIC else {}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema, qos)
        return self._channels[topic]

    def _check_free(self) -> None:
        if self._path.exists() and (not self._overwrite or self._path.is_dir()):
            hint = "is a folder" if self._path.is_dir() else "exists already; --force replaces it"
            raise UsageError(f"{self._path}: {hint}")

    def _refused(self, error: OSError) -> HiermapError:
        return output_error(self._path, error)


def mount_transform(stamp_ns: int, mount: Mount) -> Transform:
    """The static edge base_link -> laser; a flipped laser is rolled by pi after its yaw."""
    c, s = math.cos(0.5 * mount.yaw), math.sin(0.5 * mount.yaw)
    rotation = (c, s, 0.0, 0.0) if mount.flipped else (0.0, 0.0, s, c)
    return Transform(stamp_ns, BASE_FRAME, LASER_FRAME, (mount.x, mount.y, 0.0), rotation)
