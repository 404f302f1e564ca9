"""The robot's trail through the areas: a pose in an area for every scan of the log."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.estimation.stochastic_map import StochasticMap

    Array = NDArray[np.float64]


@dataclass(slots=True)
class Trail:
    """Poses in areas, appended scan by scan.

    Scans between two key scans are carried by odometry from the first and take their share of
    the correction at the second (`between` keeps them back until it comes).
    """

    stamps_ns: list[int] = field(default_factory=list)
    area: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    covariances: list[Array] = field(default_factory=list)
    key_at: list[int] = field(default_factory=list)
    _waiting: list[tuple[int, Array]] = field(default_factory=list)

    def key(self, stamp_ns: int, area: int, V: StochasticMap) -> None:
        """A scan that the filter used: the robot's estimate after it, in its area."""
        robot, C = V.robot, V.covariance[:3, :3].copy()
        if V.coordinates == "additive":
            J = se2.invariant_D_additive(robot)
            C = J @ C @ J.T
        self._settle(stamp_ns, area, robot, C)
        self.key_at.append(len(self.stamps_ns))
        self._append(stamp_ns, area, robot, C)

    def between(self, stamp_ns: int, increment: Array) -> None:
        """A scan too near the last key scan: `increment` is the odometry since then."""
        self._waiting.append((stamp_ns, increment))

    def last_stamp_ns(self) -> int:
        """Stamp of the last scan taken in, key scan or not."""
        return self._waiting[-1][0] if self._waiting else self.stamps_ns[-1]

    def finish(self) -> None:
        """Scans after the last key scan stay where odometry put them."""
        if self._waiting:
            base, C, area = self.poses[-1], self.covariances[-1], self.area[-1]
            for stamp, increment in self._waiting:
                self._append(stamp, area, se2.compose(base, increment), C)
            self._waiting = []

    def recent(self, area: int, distance: float) -> Array | None:
        """The last poses (k, 3) in this area over `distance` metres of path, oldest first."""
        out: list[Array] = []
        length = 0.0
        for i in reversed(self.key_at[-80:]):
            if self.area[i] != area or length > distance:
                break
            if out:
                length += float(np.hypot(*(self.poses[i][:2] - out[-1][:2])))
            out.append(self.poses[i])
        return np.array(out[::-1]) if len(out) > 1 else None

    def _settle(self, stamp_ns: int, area: int, robot: Array, C: Array) -> None:
        if not self._waiting:
            return
        if self.area[-1] != area:
            self.finish()
            return
        base, C_base, t_base = self.poses[-1], self.covariances[-1], self.stamps_ns[-1]
        stamps = np.array([w[0] for w in self._waiting])
        carried = se2.compose(base, np.array([w[1] for w in self._waiting]))
        f = (stamps - t_base) / max(stamp_ns - t_base, 1)
        # What remains after odometry has carried the base to the key scan, shared out by time.
        last = carried[-1]
        rest = se2.log(se2.compose(robot, se2.invert(last)))
        moved = float(np.hypot(*(robot[:2] - last[:2])))
        share = f[:, None] * rest * (1.0 if moved < 1.0 else 0.0)
        poses = se2.compose(se2.exp(share), carried)
        for k, stamp in enumerate(stamps):
            self._append(int(stamp), area, poses[k], (1.0 - f[k]) * C_base + f[k] * C)
        self._waiting = []

    def _append(self, stamp_ns: int, area: int, pose: Array, C: Array) -> None:
        self.stamps_ns.append(stamp_ns)
        self.area.append(area)
        self.poses.append(pose)
        self.covariances.append(C)
