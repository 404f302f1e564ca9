"""What a world file may say: every key with its unit, its default and its limits.

Metres, radians and seconds throughout, in the world's own frame. Shapes that enclose an area
(`box`, `polygon`) run along the **middle lines of its walls**, so that neighbours simply share
an edge; the free inside is that shape drawn in by half the wall's thickness. Furniture and
free-standing walls are given by their own outline.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from hiermap_cli.config import NonNegative, Positive, Section

Point = Annotated[tuple[float, float], Field(description="[x, y] in metres")]
Pose = Annotated[tuple[float, float, float], Field(description="[x, y, theta]")]
Box = Annotated[tuple[float, float, float, float], Field(description="[x1, y1, x2, y2]")]
Identifier = Annotated[str, Field(min_length=1, max_length=60)]

OUTSIDE = "outside"  # the other side of a door that leads out of the building


class Shape(Section):
    """A closed shape: either a box along the axes or a polygon of at least three corners."""

    box: Box | None = Field(None, description="two opposite corners")
    polygon: tuple[Point, ...] | None = Field(
        None, min_length=3, description="corners in order, either way round"
    )

    @model_validator(mode="after")
    def _one_of_both(self) -> Shape:
        if (self.box is None) == (self.polygon is None):
            raise ValueError("give either box or polygon")
        return self

    def corners(self) -> list[tuple[float, float]]:
        """The corners in the order given; a box counterclockwise."""
        if self.polygon is not None:
            return list(self.polygon)
        assert self.box is not None
        x1, x2 = sorted((self.box[0], self.box[2]))
        y1, y2 = sorted((self.box[1], self.box[3]))
        return [(x1, y1), (x2, y1), (x2, y2), (x1, y2)]


class AreaSpec(Shape):
    """A room or a corridor, along the middle lines of its walls."""

    id: Identifier
    kind: Literal["room", "corridor"] = "room"
    wall_thickness: Positive | None = Field(
        None, le=1.0, description="twice what this area's walls reach in; the world's if null"
    )


class DoorSpec(Section):
    """A door: an opening cut through the wall between two areas, with a jamb at either side."""

    id: Identifier
    areas: tuple[Identifier, Identifier] = Field(
        description=f"the areas it joins; '{OUTSIDE}' where it leads out of the building"
    )
    at: Point = Field(description="its middle, on the wall's middle line (within 5 cm)")
    width: Positive = Field(0.9, le=20.0, description="clear width between the jambs")


class FurnitureSpec(Shape):
    """Something that stands in an area at the height of the laser, by its outline."""

    turn: float = Field(0.0, description="radians it is turned about its middle")


class WallSpec(Shape):
    """A free-standing wall, a pillar or a partition: structure, not furniture."""


class WayPointSpec(Section):
    """A point that the robot drives to."""

    at: Point
    stop: NonNegative = Field(0.0, description="seconds the robot stands there")
    name: str | None = Field(None, max_length=60)


class RobotSpec(Section):
    """A round robot with two driven wheels."""

    speed: Positive = Field(0.5, description="metres a second at most")
    turn_rate: Positive = Field(0.8, description="radians a second at most")
    acceleration: Positive = Field(0.5, description="metres a second squared")
    turn_acceleration: Positive = Field(1.5, description="radians a second squared")
    turn_radius: Positive = Field(0.4, description="of the arcs that round off way points")
    radius: Positive = Field(0.2, description="what must fit through a door")
    heading: float | None = Field(
        None, description="radians at the start; towards the second way point if null"
    )


class LaserMountSpec(Section):
    """Pose of the laser on the robot."""

    x: float = Field(0.1, description="metres ahead of the robot's origin")
    y: float = 0.0
    yaw: float = 0.0
    flipped: bool = Field(False, description="upside down: beams run clockwise")


class LaserSpec(Section):
    """A scanner; a scan is taken at one moment, its stamp."""

    beams: int = Field(360, ge=2, le=20000)
    angle_min: float | None = Field(
        None, description="radians, direction of the first beam; the beams centred ahead if null"
    )
    angle_increment: float = Field(2.0 * math.pi / 360.0, description="radians between beams")
    range_min: NonNegative = Field(0.05, description="metres; a nearer return says nothing")
    range_max: Positive = Field(12.0, description="metres; beyond it nothing returns")
    rate: Positive = Field(5.0, le=1000.0, description="scans a second")
    mount: LaserMountSpec = LaserMountSpec()
    stated_mount: LaserMountSpec | None = Field(
        None, description="what the log says of the mount; the true one if null"
    )
    sigma: NonNegative = Field(0.01, description="metres, noise of a range at any distance")
    sigma_per_metre: NonNegative = Field(0.0, description="metres of noise per metre of range")

    @model_validator(mode="after")
    def _angles(self) -> LaserSpec:
        if self.angle_increment == 0.0:
            raise ValueError("angle_increment is 0: all beams would be one")
        if abs(self.angle_increment) * (self.beams - 1) > 2.0 * math.pi + 1e-9:
            raise ValueError("beams times angle_increment is more than a full turn")
        if self.range_min >= self.range_max:
            raise ValueError("range_min is not below range_max")
        return self

    @property
    def first_angle(self) -> float:
        """Direction of the first beam: as given, or so that the middle of all looks ahead."""
        if self.angle_min is not None:
            return self.angle_min
        return -0.5 * (self.beams - 1) * self.angle_increment


class BendSpec(Section):
    """An accident of the odometry: it moves where the robot does not (figure 8: 40 cm, 5 deg)."""

    after: int = Field(ge=0, description="index of the way point it happens after, from 0")
    bend: Pose = Field(description="the false motion, in the robot's frame")
    duration: NonNegative = Field(
        0.0, description="seconds over which it happens, from half-way to the next way point"
    )


class SlipSpec(Section):
    """Sudden slips of the wheels, at random places."""

    per_metre: NonNegative = Field(0.0, description="slips a metre in the mean")
    sigma_translation: NonNegative = Field(0.05, description="metres")
    sigma_rotation: NonNegative = Field(0.03, description="radians")


class WheelFaultSpec(Section):
    """A stretch of time over which odometry does not tell what the robot does."""

    kind: Literal["reversed", "missing"] = Field(
        description="the distance with the wrong sign, or no motion at all"
    )
    begin: NonNegative = Field(description="seconds after the start")
    end: Positive = Field(description="seconds after the start")

    @model_validator(mode="after")
    def _span(self) -> WheelFaultSpec:
        if self.end <= self.begin:
            raise ValueError("end is not after begin")
        return self


class OdometrySpec(Section):
    """The wheels: the noise model of the estimator's configuration, under the same names.

    The constant faults too are those that the estimator calibrates: what was driven is
    `(1 + scale)` times the distance read, and `(1 + rotation_scale)` times the angle read plus
    `curvature` times the distance read.
    """

    rate: Positive = Field(20.0, le=1000.0, description="readings a second; one at each scan too")
    sigma_xy_per_sqrt_m: NonNegative = Field(0.03, description="metres after one metre")
    sigma_xy_per_sqrt_rad: NonNegative = Field(0.02, description="metres after one radian")
    sigma_theta_per_sqrt_m: NonNegative = Field(0.02, description="radians after one metre")
    sigma_theta_per_sqrt_rad: NonNegative = Field(0.04, description="radians after one radian")
    scale: float = Field(0.0, gt=-0.9, le=10.0, description="relative error of distances")
    rotation_scale: float = Field(0.0, gt=-0.9, le=10.0, description="relative error of angles")
    curvature: float = Field(0.0, description="rad/m, heading drift over distance")
    slip: SlipSpec = SlipSpec()
    bends: tuple[BendSpec, ...] = ()
    faults: tuple[WheelFaultSpec, ...] = ()


class PeopleSpec(Section):
    """People who walk about and are seen as discs; they give way to the robot."""

    number: int = Field(0, ge=0, le=1000)
    speed: Positive = Field(1.0, description="metres a second")
    radius: Positive = Field(0.22, description="metres")


class LiftSpec(Section):
    """The robot is lifted while it drives and put down elsewhere; its wheels do not notice."""

    at: Positive = Field(description="seconds after the start")
    to: Pose = Field(description="where it is put down; it goes on to its next way point")
    pause: NonNegative = Field(1.0, description="seconds it stands, half before and half after")


class WorldSpec(Section):
    """A world file."""

    format: Literal["hiermap-world"] = "hiermap-world"
    version: tuple[Literal[1], int] = (1, 0)
    name: str = Field("world", max_length=200)
    wall_thickness: Positive = Field(0.15, le=1.0)
    areas: tuple[AreaSpec, ...]
    doors: tuple[DoorSpec, ...] = ()
    walls: tuple[WallSpec, ...] = ()
    furniture: tuple[FurnitureSpec, ...] = ()
    way_points: tuple[WayPointSpec, ...]
    start: NonNegative = Field(1000.0, description="stamp of the first scan in seconds")
    robot: RobotSpec = RobotSpec()
    laser: LaserSpec = LaserSpec()
    odometry: OdometrySpec = OdometrySpec()
    people: PeopleSpec = PeopleSpec()
    lifts: tuple[LiftSpec, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _short_way_points(cls, data: object) -> object:
        """A way point may be written as plain `[x, y]`."""
        if isinstance(data, dict) and isinstance(data.get("way_points"), list | tuple):
            points = tuple(
                {"at": tuple(p)} if isinstance(p, list | tuple) else p for p in data["way_points"]
            )
            return {**data, "way_points": points}
        return data

    @model_validator(mode="after")
    def _not_empty(self) -> WorldSpec:
        for name, entries in (("areas", self.areas), ("way_points", self.way_points)):
            if not entries:
                raise ValueError(f"{name} is empty: a world needs at least one")
        return self
