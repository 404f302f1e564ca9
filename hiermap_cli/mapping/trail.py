"""The robot's trail through the areas: a pose in an area for every scan of the log."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import DTypeLike, NDArray

    from hiermap_cli.estimation.stochastic_map import Motion, StochasticMap

    Array = NDArray[np.float64]


class Rows:
    """Many small arrays of one shape in one block of memory: an eighth of what a list takes."""

    def __init__(self, *shape: int) -> None:
        self._shape = shape
        self._size = math.prod(shape)
        self._values = array("d")

    def append(self, row: Array) -> None:
        """One more row, of the shape."""
        self._values.extend(row.ravel().tolist())

    def extend(self, rows: Array) -> None:
        """More rows, (n, shape)."""
        self._values.frombytes(np.ascontiguousarray(rows, dtype=float).tobytes())

    def drop(self, rows: int) -> None:
        """Without the last rows."""
        if rows:
            del self._values[-rows * self._size :]

    def __len__(self) -> int:
        return len(self._values) // self._size

    def __getitem__(self, i: int | slice) -> Array:
        if isinstance(i, slice):
            return np.array(self)[i]
        i = range(len(self))[i]
        part = self._values[i * self._size : (i + 1) * self._size]
        return np.array(part).reshape(self._shape)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Array:
        # A view would forbid the block to grow.
        return np.array(self._values, dtype=dtype).reshape(-1, *self._shape)


_STANDING = np.zeros(3)


class Base(NamedTuple):
    """The last key scan, as the scans after it start from it.

    Its stamp, area, and the robot's pose (3,) and invariant covariance (3, 3) there.
    """

    stamp_ns: int
    area: int
    pose: Array
    covariance: Array


@dataclass(slots=True)
class Trail:
    """Poses in areas with the covariances of their invariant errors, appended scan by scan.

    Scans between two key scans are carried by odometry from the first and take their share of
    the correction at the second (`between` keeps them back until it comes).

    key_at: where each key scan stands. increments: the odometry since the last key scan, zero
    at a key scan.
    """

    stamps_ns: list[int] = field(default_factory=list)
    area: list[int] = field(default_factory=list)
    poses: Rows = field(default_factory=lambda: Rows(3))
    covariances: Rows = field(default_factory=lambda: Rows(3, 3))
    increments: Rows = field(default_factory=lambda: Rows(3))
    key_at: list[int] = field(default_factory=list)
    _base: Base | None = None
    _waiting: list[tuple[int, Array]] = field(default_factory=list)

    def key(self, stamp_ns: int, area: int, V: StochasticMap, motion: Motion | None = None) -> None:
        """A scan that the filter used: the robot's estimate after it, in its area.

        `motion` is the odometry since the last key scan, as the filter predicted by it.
        """
        base = Base(stamp_ns, area, V.robot, invariant_covariance(V))
        if motion is not None:
            self._settle(base, motion)
        self.key_at.append(len(self.stamps_ns))
        self._append(stamp_ns, area, base.pose, base.covariance, _STANDING)
        self._base = base

    def enter(self, area: int, V: StochasticMap) -> None:
        """The robot, where it is, is now in another area: what follows starts from there."""
        assert self._base is not None
        self._base = Base(self._base.stamp_ns, area, V.robot, invariant_covariance(V))

    def between(self, stamp_ns: int, increment: Array) -> None:
        """A scan too near the last key scan: `increment` is the odometry since then."""
        self._waiting.append((stamp_ns, increment))

    def rewind(self, keys: int, area: int, V: StochasticMap) -> None:
        """As it was before the last `keys` key scans and all scans after them.

        The key scan before them was in `area`, with the robot as it is in V.
        """
        left = self.key_at[len(self.key_at) - 1 - keys]
        del self.key_at[len(self.key_at) - keys :]
        gone = len(self.stamps_ns) - 1 - left
        del self.stamps_ns[left + 1 :], self.area[left + 1 :]
        for rows in (self.poses, self.covariances, self.increments):
            rows.drop(gone)
        self._waiting = []
        self._base = Base(self.stamps_ns[-1], area, V.robot, invariant_covariance(V))

    def last_stamp_ns(self) -> int:
        """Stamp of the last scan taken in, key scan or not."""
        return self._waiting[-1][0] if self._waiting else self.stamps_ns[-1]

    def last_increment(self) -> Array | None:
        """The odometry from the last key scan to the last scan, or None if that is the same."""
        return self._waiting[-1][1] if self._waiting else None

    def finish(self, carry: Callable[[Array], Motion]) -> None:
        """Scans after the last key scan stay where odometry put them; `carry` is its model."""
        if self._waiting:
            base = self._base
            assert base is not None
            for stamp, increment in self._waiting:
                motion = carry(increment)
                pose = se2.compose(base.pose, motion.pose)
                Ad = se2.adjoint(pose)
                C = base.covariance + Ad @ motion.covariance @ Ad.T
                self._append(stamp, base.area, pose, C, increment)
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

    def _settle(self, key: Base, motion: Motion) -> None:
        """Place the waiting scans between the last key scan and this one.

        Odometry carries each from the last key scan; what then remains at this one is shared
        out by how far each has come. The noise in between is that of a bridge held at both ends.
        """
        if not self._waiting:
            return
        base = self._base
        assert base is not None
        increments = np.array([increment for _, increment in self._waiting])
        carried = se2.compose(base.pose, increments)
        rest = se2.log(se2.compose(key.pose, se2.invert(se2.compose(base.pose, motion.pose))))
        f = np.clip(_progress(increments) / max(float(_progress(motion.pose)), 1e-9), 0.0, 1.0)
        poses = se2.compose(se2.exp(f[:, None] * rest), carried)
        Ad = se2.adjoint(key.pose)
        bridge = Ad @ motion.covariance @ Ad.T
        for (stamp, increment), pose, g in zip(self._waiting, poses, f.tolist(), strict=True):
            C = (1.0 - g) * base.covariance + g * key.covariance + g * (1.0 - g) * bridge
            self._append(stamp, base.area, pose, C, increment)
        self._waiting = []

    def _append(self, stamp_ns: int, area: int, pose: Array, C: Array, increment: Array) -> None:
        self.stamps_ns.append(stamp_ns)
        self.area.append(area)
        self.poses.append(pose)
        self.covariances.append(C)
        self.increments.append(increment)


def invariant_covariance(V: StochasticMap) -> Array:
    """Covariance (3, 3) of the robot's invariant error."""
    C = V.covariance[:3, :3]
    if V.coordinates == "invariant":
        return C.copy()
    T = V.invariant_D_error(V.robot)
    return np.asarray(T @ C @ T.T)


def _progress(increment: Array) -> Array:
    """How far an increment (..., 3) has come, with a radian counted as 30 cm."""
    return np.hypot(increment[..., 0], increment[..., 1]) + 0.3 * np.abs(increment[..., 2])
