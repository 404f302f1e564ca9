"""The result of a run as values: what `documents` writes and `evaluation` judges.

Means and covariances are additive, `[x, y, theta]` in the frame named, as in formats.md.
Frames: g global, an area's id for an area's frame, a landmark's id for a landmark's frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A Gaussian estimate: mean (n,), covariance (n, n), in the frame whose id is `frame`."""

    frame: str
    mean: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class SegmentFeature:
    """A segment S = (p, q) of a landmark, in the landmark's frame.

    `line_type` 0 is x = p y + q, 1 is y = p x + q. From `endpoints[0]` to `endpoints[1]` the
    material lies on the right-hand side: the free side, from where it was seen, is on the left.
    `endless[i]` is True where end i was never seen as a true vertex.
    """

    p: float
    q: float
    line_type: int
    covariance: Array  # (2, 2) of (p, q)
    endpoints: Array  # (2, 2)
    endless: tuple[bool, bool]


@dataclass(frozen=True, slots=True)
class PointFeature:
    """A point P = (x, y) of a landmark, in the landmark's frame."""

    mean: Array  # (2,)
    covariance: Array  # (2, 2)


@dataclass(frozen=True, slots=True)
class LandmarkModel:
    """A landmark: its state vector V = (robot in the landmark's frame, features), and C(V)."""

    id: str
    area: str
    kind: str
    binds: tuple[str, ...]
    robot: Estimate
    features: tuple[SegmentFeature | PointFeature, ...]
    covariance: Array  # (3 + 2k, 3 + 2k)
    observations: int
    utility: float


@dataclass(frozen=True, slots=True)
class AreaModel:
    """An area: its state vector V = (robot in the area's frame, landmark poses), and C(V)."""

    id: str
    kind: Literal["room", "corridor", "unknown"]
    entered_by: str | None
    robot: Estimate
    landmarks: tuple[tuple[str, Estimate], ...]
    covariance: Array  # (3 + 3k, 3 + 3k)
    extent: Array  # (m, 2) polygon of the free space seen, in the area's frame


@dataclass(frozen=True, slots=True)
class DoorModel:
    """A door or opening that the robot crossed, between two areas; `estimate` is in g."""

    id: str
    areas: tuple[str, str]
    landmarks: tuple[str, ...]
    width: float
    estimate: Estimate
    crossings: int


@dataclass(frozen=True, slots=True)
class EnvironmentModel:
    """The environment: V = (robot in g, area frames in g in the order of `areas`), and C(V)."""

    robot: Estimate
    areas: tuple[tuple[str, Estimate], ...]
    covariance: Array  # (3 + 3k, 3 + 3k)
    doors: tuple[DoorModel, ...]


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Robot poses in g: stamps_ns (N,) int64, poses (N, 3), covariances (N, 3, 3)."""

    stamps_ns: NDArray[np.int64]
    poses: Array
    covariances: Array


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at `stamp_ns`; `details` go into report.json beside t and kind."""

    stamp_ns: int
    kind: str
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Metric:
    """One figure of a report: its name, units, value and the number of samples behind it."""

    name: str
    units: str
    value: float
    n: int


@dataclass(frozen=True, slots=True)
class HierarchicalModel:
    """The three levels of the paper, final."""

    environment: EnvironmentModel
    areas: tuple[AreaModel, ...]
    landmarks: tuple[LandmarkModel, ...]


@dataclass(frozen=True, slots=True)
class MapResult:
    """Everything a run found out; the counts of the input are added by the command.

    consistency: what the innovations say of the covariances, see `mapping.trust`.
    """

    model: HierarchicalModel
    trajectory: Trajectory
    trajectory_filter: Trajectory
    events: tuple[Event, ...]
    metrics: tuple[Metric, ...]
    timing: dict[str, float]
    dropped: dict[str, int]
    consistency: dict[str, Any] = field(default_factory=dict)
