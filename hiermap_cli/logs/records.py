"""The values that come out of a log: scans, odometry, and blocks of both joined in time.

Stamps are integer nanoseconds in the log's own time. Ranges are metres; **+inf means that
nothing was there within the laser's reach** (free space up to the limit), **nan means that the
beam says nothing**. Readers translate every maker's convention into these two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class LaserGeometry(NamedTuple):
    """Angles of a scan's beams in the laser's own frame (radians) and its reach (metres)."""

    angle_min: float
    angle_increment: float
    beams: int
    range_min: float
    range_max: float

    def angles(self) -> NDArray[np.float64]:
        """Beam angles, shape (beams,), in the laser's frame."""
        return self.angle_min + self.angle_increment * np.arange(self.beams, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Mount:
    """Pose of the laser in the robot's frame, `R_r_s`; `flipped` is a roll of pi (mirrored)."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    flipped: bool = False

    def pose(self) -> NDArray[np.float64]:
        """`R_r_s` as `[x, y, theta]`."""
        return np.array([self.x, self.y, self.yaw])


class Scan(NamedTuple):
    """One scan as read: `ranges` (beams,) float32, stamp of its header, frame of the laser."""

    stamp_ns: int
    ranges: NDArray[np.float32]
    laser: LaserGeometry
    frame: str = ""


class Odometry(NamedTuple):
    """One odometry reading: pose of the robot in the odometry's frame, `[x, y, theta]`.

    `theta` is as the log has it, not wrapped. `frame` is the odometry's frame, `child` the
    robot's, both empty where the format has no frames.
    """

    stamp_ns: int
    x: float
    y: float
    theta: float
    frame: str = ""
    child: str = ""


class Transform(NamedTuple):
    """One edge of the tree of frames: the pose of `child` in `parent`, in space.

    translation: (x, y, z) in metres; rotation: quaternion (x, y, z, w), normalised or not.
    """

    stamp_ns: int
    parent: str
    child: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


class Record(NamedTuple):
    """One value of a log, in log order: a message, or one of several that a message carries.

    `log_ns` is when the recorder wrote it. `value` is None for a message of a type that is of
    no use here, or that could not be decoded (`fault` then says why).
    """

    topic: str
    log_ns: int
    value: Scan | Odometry | Transform | None
    fault: str = ""


class Topic(NamedTuple):
    """What a log says of one of its topics; `messages` is None where only reading tells."""

    name: str
    type: str
    encoding: str
    kind: str
    messages: int | None


SCANS = "scans"
ODOMETRY = "odometry"
SCANS_WITH_ODOMETRY = "scans with odometry"
TRANSFORMS = "transforms"
STATIC_TRANSFORMS = "static transforms"
OTHER = "other"


@dataclass(frozen=True, slots=True)
class ScanBlock:
    """Up to some hundred successive scans of one laser geometry, odometry interpolated to each.

    stamps_ns: (B,) int64, not decreasing within the log.
    ranges: (B, beams) float32, +inf nothing in reach, nan says nothing.
    odometry: (B, 3) float64, the robot in the odometry's frame at each stamp; for scans before
        the first reading it is the first reading.
    has_odometry: (B,) bool, False where no reading brackets or precedes the stamp.
    repeated: (B,) bool, True where stamp and ranges are those of the scan before, which may be the
        last one of the block before; None where no scan is.
    """

    stamps_ns: NDArray[np.int64]
    ranges: NDArray[np.float32]
    odometry: NDArray[np.float64]
    has_odometry: NDArray[np.bool_]
    laser: LaserGeometry
    mount: Mount
    repeated: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def part(self, places: slice | NDArray[np.int64]) -> ScanBlock:
        """Some of the scans, as a block."""
        return ScanBlock(
            stamps_ns=self.stamps_ns[places],
            ranges=self.ranges[places],
            odometry=self.odometry[places],
            has_odometry=self.has_odometry[places],
            laser=self.laser,
            mount=self.mount,
            repeated=None if self.repeated is None else self.repeated[places],
        )
