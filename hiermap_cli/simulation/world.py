"""A world: a floor plan, a robot with its sensors, and the journey it makes there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hiermap_cli.errors import ConfigurationError
from hiermap_cli.faults import with_lines
from hiermap_cli.logs.records import LaserGeometry, Mount
from hiermap_cli.simulation.journey import check_journey, plan_journey
from hiermap_cli.simulation.plan import build_plan

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from hiermap_cli.faults import Fault, KeyPath
    from hiermap_cli.simulation.journey import Journey
    from hiermap_cli.simulation.plan import FloorPlan
    from hiermap_cli.simulation.spec import LaserMountSpec, WorldSpec


@dataclass(frozen=True, slots=True)
class World:
    """What a world file says (`spec`), and what follows from it."""

    spec: WorldSpec
    plan: FloorPlan
    journey: Journey

    @property
    def laser(self) -> LaserGeometry:
        """The beams of a scan."""
        laser = self.spec.laser
        return LaserGeometry(
            laser.first_angle,
            laser.angle_increment,
            laser.beams,
            laser.range_min,
            laser.range_max,
        )

    @property
    def mount(self) -> Mount:
        """Where the laser truly is on the robot."""
        return _mount(self.spec.laser.mount)

    @property
    def stated_mount(self) -> Mount:
        """Where the log says that it is."""
        return _mount(self.spec.laser.stated_mount or self.spec.laser.mount)


def _mount(spec: LaserMountSpec) -> Mount:
    return Mount(spec.x, spec.y, spec.yaw, spec.flipped)


def load_world(path: Path) -> World:
    """The world in a YAML file.

    Raises:
        ConfigurationError: the file cannot be read or has faults; all of one kind are listed:
            first those of the file's shape, then those of the plan, then those of the journey;
            each with its line.
    """
    from hiermap_cli.configfile import read_with_lines
    from hiermap_cli.simulation.spec import WorldSpec

    spec, lines = read_with_lines(path, WorldSpec)
    return build_world(spec, str(path), lines)


def build_world(
    spec: WorldSpec, source: str = "world", lines: Mapping[KeyPath, int] | None = None
) -> World:
    """The world of a specification; `source` names it in messages, `lines` says where keys stand.

    Raises:
        ConfigurationError: the floor plan or the journey has faults; all are listed.
    """
    faults: list[Fault] = []
    plan = build_plan(spec, faults)
    journey = plan_journey(spec, faults)
    if plan is not None and journey is not None:
        check_journey(spec, plan, journey, faults)
        if not faults:
            return World(spec, plan, journey)
    if lines is None:
        raise ConfigurationError(source, [fault.text() for fault in faults])
    from hiermap_cli.configfile import fault_lines

    raise ConfigurationError(source, fault_lines(with_lines(faults, lines)))
