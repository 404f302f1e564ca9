"""The configuration of a run: every key, its default, its unit and why it has that value.

One set of values serves all logs; only the `laser` section describes a particular sensor. The
sections are frozen; a stage receives its own section and nothing else.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hiermap_cli.config_fields import NonNegative, Positive, Section
from hiermap_cli.config_mapping import (
    AreaConfig,
    DoorConfig,
    ForgetConfig,
    LandmarkConfig,
    LoopConfig,
    LostConfig,
    OdometryFaultConfig,
    RefineConfig,
    RelocationConfig,
)

__all__ = [
    "AreaConfig",
    "AssociationConfig",
    "Config",
    "DoorConfig",
    "FilterConfig",
    "ForgetConfig",
    "InputConfig",
    "LandmarkConfig",
    "LaserConfig",
    "LoopConfig",
    "LostConfig",
    "MountConfig",
    "NoiseConfig",
    "NonNegative",
    "OdometryConfig",
    "OdometryFaultConfig",
    "Positive",
    "RefineConfig",
    "RelocationConfig",
    "Section",
    "SegmentationConfig",
]


class MountConfig(Section):
    """Pose of the laser on the robot, for logs that do not say it."""

    x: float = Field(0.0, description="metres ahead of the robot's origin")
    y: float = Field(0.0, description="metres to the left of the robot's origin")
    yaw: float = Field(0.0, description="radians, counterclockwise")
    flipped: bool = Field(False, description="mounted upside down: beams run clockwise")


class InputConfig(Section):
    """What to read from the log."""

    scan_topic: str | None = Field(None, description="topic of the scans; found by type if null")
    odometry_topic: str | None = Field(None, description="topic of the odometry; found if null")
    mount: MountConfig | None = Field(None, description="overrides the mount that the log gives")
    start: float | None = Field(None, description="seconds after the first stamp to begin at")
    end: float | None = Field(None, description="seconds after the first stamp to end at")


class LaserConfig(Section):
    """The sensor's own figures; null where the log or the data themselves tell."""

    range_min: NonNegative | None = Field(None, description="metres; nearer returns are dropped")
    range_max: Positive | None = Field(None, description="metres; farther returns count as none")
    sigma_range: Positive = Field(0.01, description="metres, noise of a range at any distance")
    sigma_range_scale: NonNegative = Field(0.0, description="metres of noise per metre of range")
    sigma_bearing: NonNegative = Field(0.0, description="radians, noise of a beam's direction")


class SegmentationConfig(Section):
    """Split and merge (section 4)."""

    min_points: int = Field(5, ge=3, description="points that a segment needs")
    min_length: Positive = Field(0.25, description="metres; shorter segments are dropped")
    split_sigmas: Positive = Field(3.0, description="a run is split where it bends by more")
    split_floor: Positive = Field(0.03, description="metres; unevenness a wall may have")
    breakpoint_angle: Positive = Field(
        0.17, description="radians; the steepest incidence at which a surface is still one"
    )
    max_range: Positive = Field(30.0, description="metres; returns beyond are not segmented")
    max_gap_beams: int = Field(
        3, ge=0, description="beams without a word that a surface may go on across"
    )
    merge_gap: NonNegative = Field(
        0.5, description="metres; pieces of one line are joined across something before them"
    )
    outlier_sigmas: Positive = Field(4.0, description="points farther off a line do not count")
    vertex_width: Positive = Field(
        0.3, description="metres; a wall whose end is known worse is not known to meet another"
    )
    free_depth: Positive = Field(
        0.08, description="metres behind a wall's end that make it an edge, not an uneven wall"
    )


class OdometryConfig(Section):
    """Noise of the wheel odometry, and the priors of its constant faults."""

    sigma_xy_per_sqrt_m: Positive = Field(0.06, description="metres after one metre")
    sigma_xy_per_sqrt_rad: NonNegative = Field(0.02, description="metres after one radian")
    sigma_theta_per_sqrt_m: Positive = Field(0.04, description="radians after one metre")
    sigma_theta_per_sqrt_rad: Positive = Field(0.1, description="radians after one radian")
    prior_scale: NonNegative = Field(0.05, description="relative error of distances")
    prior_rotation_scale: NonNegative = Field(0.05, description="relative error of rotations")
    prior_curvature: NonNegative = Field(0.05, description="rad/m, heading drift over distance")
    fault_sigma_xy: Positive = Field(0.3, description="metres, when odometry has failed")
    fault_sigma_theta: Positive = Field(0.5, description="radians, when odometry has failed")
    prior_laser_x: NonNegative = Field(0.1, description="metres, error of the laser's x")


class NoiseConfig(Section):
    """Noise estimated from the log itself, by factors on the variances below."""

    estimate: bool = Field(True, description="false: take the figures of this file as they are")
    warm_up: int = Field(120, ge=0, description="key scans run twice, to learn the noise first")
    warm_up_rate: Positive = Field(0.15, description="of the factors' logarithm, in the warm-up")
    rate: NonNegative = Field(0.01, description="of the factors' logarithm, afterwards")
    laser_range: tuple[Positive, Positive] = Field(
        (1e-4, 4.0), description="bounds of the factor on the laser's variance"
    )
    odometry_range: tuple[Positive, Positive] = Field(
        (0.3, 30.0), description="bounds of the factor on the odometry's variances"
    )
    walls_range: tuple[Positive, Positive] = Field(
        (1e-4, 10.0), description="bounds of the factor on the walls' unevenness"
    )


class FilterConfig(Section):
    """What becomes a measurement, and when."""

    features: Literal["all", "walls", "landmarks"] = Field(
        "all",
        description="walls: their ends are not measured; landmarks: no wall is that has no end",
    )
    key_distance: Positive = Field(0.15, description="metres between scans that the filter uses")
    key_angle: Positive = Field(0.07, description="radians between scans that the filter uses")
    min_match_length: Positive = Field(0.3, description="metres; a segment that may be matched")
    min_new_length: Positive = Field(0.4, description="metres; a segment that may found a wall")
    wall_sigma: NonNegative = Field(0.02, description="metres; walls are not lines")
    wall_sigma_theta: NonNegative = Field(0.01, description="radians; walls are not lines")
    end_spacing: Positive = Field(0.5, description="metres between different ends of a wall")
    end_patience: int = Field(8, ge=1, description="key scans within which an end is seen twice")
    end_sigma: NonNegative = Field(0.03, description="metres; ends of walls are not points")


class AssociationConfig(Section):
    """Gates of the matching."""

    joint: bool = Field(True, description="false: each segment's best wall, without regard to all")
    gate: Positive = Field(0.999, lt=1, description="probability of the chi-square gates")
    max_angle: Positive = Field(0.26, description="radians between a segment and its wall")
    max_offset: Positive = Field(1.0, description="metres between a segment and its wall")
    overlap_bonus: NonNegative = Field(2.0, description="of a pair's cost, for full overlap")
    max_gap: Positive = Field(0.4, description="metres between a segment and the wall's extent")


class Config(Section):
    """The whole configuration of `hiermap run`."""

    input: InputConfig = InputConfig()
    laser: LaserConfig = LaserConfig()
    segmentation: SegmentationConfig = SegmentationConfig()
    odometry: OdometryConfig = OdometryConfig()
    odometry_faults: OdometryFaultConfig = OdometryFaultConfig()
    lost: LostConfig = LostConfig()
    noise: NoiseConfig = NoiseConfig()
    filter: FilterConfig = FilterConfig()
    association: AssociationConfig = AssociationConfig()
    relocation: RelocationConfig = RelocationConfig()
    forget: ForgetConfig = ForgetConfig()
    doors: DoorConfig = DoorConfig()
    areas: AreaConfig = AreaConfig()
    landmarks: LandmarkConfig = LandmarkConfig()
    refine: RefineConfig = RefineConfig()
    loops: LoopConfig = LoopConfig()
    start_pose: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="x, y, theta of the robot at the first scan, in g"
    )
    update: Literal["relocation_fusion", "ekf"] = Field(
        "relocation_fusion", description="how a constraint is added (section 3.3)"
    )
    coordinates: Literal["invariant", "additive"] = Field(
        "invariant", description="in which coordinates the errors are Gaussian"
    )
