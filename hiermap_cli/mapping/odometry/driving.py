"""How the robot has come from key scan to key scan: by its odometry, as far as that is believed.

Odometry may tell what no robot does, stay silent while the robot moves, come late and all at
once, or tell the wrong direction. Where it does, the motion is *distrusted*: it says little, and
nothing of the calibration, and it is the walls that tell where the robot has come.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.stochastic_map import predict
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.association.area_filter import observe
from hiermap_cli.mapping.odometry.carried import Carried, CarryWatch
from hiermap_cli.mapping.odometry.direction import DirectionWatch, Drive
from hiermap_cli.mapping.odometry.standstill import Standstill

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.odometry.stepping import Stepper
    from hiermap_cli.mapping.odometry.stretches import Stretches
    from hiermap_cli.mapping.trail import Trail
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]

MOVED = 0.04  # metres or radians that a robot which is said to stand has moved


class Coming(NamedTuple):
    """How a scan's robot has come, by what is told.

    increment: (3,) since the last key scan, as it is believed. belied: whether the robot may
    move unnoticed by its odometry. carried: whether it was put down elsewhere.
    """

    increment: Array
    belied: bool
    carried: Carried


class Overdue(NamedTuple):
    """Where the robot was when its odometry ceased: number of the area, pose and odometry (3,)."""

    area: int
    pose: Array
    odometry: Array


@dataclass(slots=True)
class Driving:
    """Decides for each key scan by which motion the robot has come to it."""

    stepper: Stepper
    stretches: Stretches
    direction: DirectionWatch = field(init=False)
    _standstill: Standstill = field(init=False)
    _carry: CarryWatch = field(init=False)
    _odometry: Array = field(default_factory=lambda: np.zeros(3))
    _overdue: Overdue | None = None

    def __post_init__(self) -> None:
        self.direction = DirectionWatch(self.stepper)
        self._standstill = Standstill(self.stepper.config.odometry_faults)
        self._carry = CarryWatch(self.stepper.config.lost)

    def come(self, stamp_ns: int, odometry: Array, ranges: Array) -> Coming:
        """The next scan, with its odometry (3,) and ranges (n,)."""
        self._odometry = odometry
        belied = self._standstill.belied(odometry, ranges)
        carried = self._carry.put_down(odometry, ranges)
        return Coming(self.direction.come(stamp_ns, odometry), belied, carried)

    def unnoticed(self, area: AreaMap, increment: Array, view: SegmentView, key: int) -> bool:
        """Whether the walls fit clearly better if the robot has not come as its odometry tells."""
        view, step = self.stepper.noisy(view), self.stepper
        costs = []
        for trusted in (True, False):
            V = predict(area.V, step.motion(area, increment, trusted=trusted))
            costs.append(step.misfit(observe(area.with_map(V), view, key, step.config)))
        return costs[1] < costs[0] - step.config.odometry_faults.clear

    def drive(
        self, area: AreaMap, number: int, increment: Array, trail: Trail, *, missing: bool
    ) -> Drive:
        """How the robot has come to the present scan, by its odometry and whether that can be.

        `area`, of that number, is where it was at the last key scan, `trail` the way up to now.
        """
        implausible = self._implausible(increment, number, trail)
        far = math.hypot(increment[0], increment[1]) > self.stepper.config.relocation.max_distance
        if implausible and self._overdue is not None and self._overdue.area == number:
            # What was missing comes all at once, and tells of where the robot was before.
            since = self._overdue
            told = se2.between(since.odometry, self._odometry)
            increment = se2.between(area.V.robot, se2.compose(since.pose, told))
        elif implausible and far:
            # Farther than is searched: it never was there, and the wheels still told where it
            # was at the last scan.
            last = trail.last_increment()
            increment = np.zeros(3) if last is None else last
        trusted = not (implausible or missing)
        motion = self.stepper.motion(area, increment, trusted=trusted)
        if not missing:
            self.stretches.end("odometry_missing")
            self._overdue = None
        return Drive(*self.direction.leg(increment), motion, trusted, area)

    def missed(self, number: int, drive: Drive, after: AreaMap) -> None:
        """Note that odometry was missing on a drive, if the walls show that the robot moved."""
        self._carry.forget()
        moved = se2.between(drive.before.V.robot, after.V.robot)
        if math.hypot(moved[0], moved[1]) > MOVED or abs(moved[2]) > MOVED:
            stamps_ns = drive.leg.stamps_ns
            self.stretches.begin(
                "odometry_missing", stamps_ns[0], stamps_ns[-1], area=f"A{number + 1}"
            )
            if self._overdue is None:
                self._overdue = Overdue(number, drive.before.V.robot, self._odometry)

    def _implausible(self, increment: Array, number: int, trail: Trail) -> bool:
        """Whether no robot of this kind moves so: the odometry has failed since the last scan."""
        c = self.stepper.config.relocation
        stamp_ns, last_ns = self.direction.stamp_ns(), trail.last_stamp_ns()
        seconds = max(stamp_ns - last_ns, 1) * 1e-9
        dx, dy, turn = increment.tolist()
        slow = math.hypot(dx, dy) < max(c.max_speed * seconds, 0.3)
        if slow and abs(turn) < max(c.max_turn_rate * seconds, 0.3):
            return False
        self.stretches.note(
            "odometry_failed", last_ns, stamp_ns, area=f"A{number + 1}",
            increment=increment.tolist(),
        )  # fmt: skip
        return True
