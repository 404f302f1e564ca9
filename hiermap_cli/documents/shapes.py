"""The shape of every JSON document, as pydantic models: the one source of the JSON Schemas.

A document is checked against these at run time (in compiled code, all faults at once with their
path), and the files in `schemas/` are generated from them, for other programs; a test holds the
two together and the output against the files with an independent validator. Unknown keys are
allowed everywhere: documents grow by keys. Here is shape only; what must hold between the parts
of a document is in `semantics`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Point = Annotated[list[Finite], Field(min_length=2, max_length=2)]
Pose = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Line = Annotated[list[Finite], Field(min_length=4, max_length=4)]
Matrix2 = Annotated[list[Point], Field(min_length=2, max_length=2)]
Matrix3 = Annotated[list[Pose], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[list[Finite]], Field(min_length=3)]
Id = Annotated[str, Field(min_length=1)]
AreaKind = Literal["room", "corridor", "unknown"]
Version = Annotated[
    list[Count], Field(min_length=2, max_length=2, description="major and minor number")
]


class Shape(BaseModel):
    """A JSON object: values of exactly the type named, further keys allowed."""

    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)


class PoseEstimate(Shape):
    """ESTIMATE: a pose [x, y, theta] in a frame, with its covariance."""

    frame: Id = Field(description="id of the reference frame")
    mean: Pose = Field(description="metres, metres, radians in (-pi, pi]")
    covariance: Matrix3 = Field(description="of the additive error of (x, y, theta)")


# --- model.json ---------------------------------------------------------------------------------


class AreaInEnvironment(Shape):
    """An area's frame in the global frame."""

    id: Id
    kind: AreaKind
    estimate: PoseEstimate
    entered_by: Id | None = Field(description="door of the first entry; null where there was none")


class Door(Shape):
    """A door or opening that the robot crossed: its frame has X along the jambs, Y across."""

    id: Id
    areas: Annotated[list[Id], Field(min_length=2, max_length=2)]
    landmarks: list[Id] = Field(description="its landmark in the first and in the second area")
    width: NonNegative = Field(description="metres")
    estimate: PoseEstimate
    crossings: Count


class Environment(Shape):
    """The upper level: V = (robot, areas in the order listed)."""

    frame: Literal["g"]
    robot: PoseEstimate
    areas: list[AreaInEnvironment]
    covariance: Matrix = Field(description="joint covariance of V")
    doors: list[Door]


class LandmarkInArea(Shape):
    """A landmark's frame in its area's frame."""

    id: Id
    estimate: PoseEstimate


class Area(Shape):
    """The middle level: V = (robot, landmarks in the order listed), in the area's frame."""

    id: Id
    frame: Id
    robot: PoseEstimate = Field(description="as of the last time the robot was there")
    landmarks: list[LandmarkInArea]
    covariance: Matrix = Field(description="joint covariance of V")
    extent: list[Point] = Field(description="polygon of the free space seen, not closed")


class SegmentShape(Shape):
    """A line segment: x = p y + q (type 0) or y = p x + q (type 1), material on the right."""

    kind: Literal["segment"]
    p: Finite
    q: Finite
    type: Literal[0, 1]
    covariance: Matrix2 = Field(description="of (p, q)")
    endpoints: Annotated[list[Point], Field(min_length=2, max_length=2)]
    endless: Annotated[list[bool], Field(min_length=2, max_length=2)]


class PointShape(Shape):
    """A point of a landmark."""

    kind: Literal["point"]
    mean: Point
    covariance: Matrix2


class Landmark(Shape):
    """The lower level: V = (robot, features in the order listed), in the landmark's frame."""

    id: Id
    area: Id
    frame: Id
    kind: Id = Field(description="corner_concave, corner_convex, door, corridor, crossing, ...")
    binds: list[Literal["x", "y", "theta"]] = Field(description="the components it determines")
    robot: PoseEstimate
    features: list[Annotated[SegmentShape | PointShape, Field(discriminator="kind")]]
    covariance: Matrix = Field(description="joint; exactly known components have zero rows")
    observations: Annotated[int, Field(ge=1)]
    utility: Finite


class ModelDocument(Shape):
    """model.json: the landmark, area and environment models of a run."""

    format: Literal["hiermap-model"]
    version: Version
    environment: Environment
    areas: list[Area]
    landmarks: list[Landmark]


# --- report.json and eval.json ------------------------------------------------------------------


class MetricShape(Shape):
    """One figure, with its units and the number of samples behind it."""

    name: Id
    units: str
    value: Finite
    n: Count


class ReportInput(Shape):
    """What was read."""

    log: str = Field(description="file name, without its folder")
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    scan_topic: str | None
    odometry_topic: str | None
    scans: Count
    odometry: Count
    dropped: dict[str, Count] = Field(description="what was not used, by reason")


class ReportSoftware(Shape):
    """Versions of what computed it."""

    hiermap: str
    python: str
    numpy: str


class EventShape(Shape):
    """Something that happened; further keys by kind."""

    t: Finite = Field(description="seconds, in the log's time")
    kind: Id


class ReportDocument(Shape):
    """report.json: how a run went."""

    format: Literal["hiermap-report"]
    version: Version
    input: ReportInput
    software: ReportSoftware
    config: dict[str, Any] = Field(description="the effective configuration, defaults included")
    metrics: list[MetricShape]
    events: list[EventShape]
    timing: dict[str, NonNegative] = Field(description="seconds by stage")


class LimitShape(Shape):
    """A limit on a metric; value null where it could not be measured, which never passes."""

    metric: Id
    comparison: str = "<="
    limit: str | Finite
    value: Finite | None
    passed: bool
    text: str = Field("", description="the limit as it was given")


class UnmeasuredShape(Shape):
    """A metric that could not be measured."""

    name: Id
    reason: str


class EvalDocument(Shape):
    """eval.json: how right a run is."""

    format: Literal["hiermap-eval"]
    version: Version
    passed: bool
    verdict: str = Field("", description="whether the covariances may be trusted, in a sentence")
    warnings: list[str] = Field([], description="what was asked for and could not be done at all")
    metrics: list[MetricShape]
    limits: list[LimitShape]
    not_measured: list[UnmeasuredShape] = Field(
        [], description="metrics that could not be measured, and why"
    )


# --- reference.json, summary.json, jobs ---------------------------------------------------------


class ReferenceDoor(Shape):
    """A door of a reference map, between its two jambs."""

    id: Id
    areas: Annotated[list[Id], Field(min_length=2, max_length=2)]
    p1: Point
    p2: Point
    visited: bool = True


class ReferenceArea(Shape):
    """An area of a reference map."""

    id: Id
    kind: str = "unknown"
    polygon: Annotated[list[Point], Field(min_length=3)]
    visited: bool = True


class ReferenceDocument(Shape):
    """reference.json: a map held to be true. Any list may be missing."""

    format: Literal["hiermap-reference"]
    version: Version
    units: Literal["m"]
    walls: list[Line] | None = None
    furniture: list[Line] | None = None
    doors: list[ReferenceDoor] | None = None
    areas: list[ReferenceArea] | None = None


class SummaryRow(Shape):
    """One job of a batch."""

    name: Id
    status: Literal["done", "failed", "limit_missed"]
    reason: str | None = None
    metrics: dict[str, Any]
    seconds: NonNegative | None = None
    peak_memory: NonNegative | None = Field(None, description="bytes")


class SummaryDocument(Shape):
    """summary.json of a batch: a row per job."""

    format: Literal["hiermap-summary"]
    version: Version
    jobs: list[SummaryRow]


class JobInput(Shape):
    """A file that a job's result was made of."""

    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    state: Any = Field(description="what would show a change: sizes, times, inodes, or a tag")
    seen_ns: int


class JobDocument(Shape):
    """job.json of a batch: what a result was made of, and its row of the summary."""

    format: Literal["hiermap-job"]
    version: Version
    key: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    made: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    judged: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    inputs: dict[str, JobInput]
    run: dict[str, Any]
    row: dict[str, Any]


class JobDefaults(Shape):
    """What holds for every job that says nothing else; paths are relative to the file."""

    model_config = ConfigDict(extra="forbid")

    config: str | list[str] | None = None
    reference: str | None = None
    trajectory: str | None = None
    relations: str | None = None
    limits: list[str] | None = None
    time_limit: float | str | None = Field(None, description="seconds, or as in 90s, 10m, 1.5h")
    memory_limit: int | str | None = Field(None, description="bytes, or as in 500MB, 2GB, 1.5GiB")


class JobShape(JobDefaults):
    """One job, or, by a glob or a list, one for each combination."""

    name: Id
    log: str | list[str]


class JobsDocument(Shape):
    """JOBS.yaml of a batch."""

    model_config = ConfigDict(extra="forbid")

    defaults: JobDefaults | None = None
    jobs: Annotated[list[JobShape], Field(min_length=1)]
