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


AT_ONCE = 64  # stretches whose arithmetic is done at one stroke
_STANDING = np.zeros(3)


class Base(NamedTuple):
    """The last key scan, as the scans after it start from it.

    Its stamp, area, and the robot's pose (3,) and invariant covariance (3, 3) there.
    """

    stamp_ns: int
    area: int
    pose: Array
    covariance: Array


class Stretch(NamedTuple):
    """The way to a key scan: from the key scan before, and the scans in between.

    motion: the odometry all the way, as the filter predicted by it. increments: (w, 3) the
    odometry from the start to each scan in between.
    """

    start: Base
    end: Base
    motion: Motion
    increments: list[Array]


@dataclass(slots=True)
class Trail:
    """Poses in areas with the covariances of their invariant errors, appended scan by scan.

    Scans between two key scans are carried by odometry from the first and take their share of
    the correction at the second (`between` keeps them back until it comes). The arithmetic of
    many stretches is done at one stroke, when they are asked for or have become many.

    key_at: where each key scan stands.
    """

    stamps_ns: list[int] = field(default_factory=list)
    area: list[int] = field(default_factory=list)
    key_at: list[int] = field(default_factory=list)
    _poses: Rows = field(default_factory=lambda: Rows(3))
    _covariances: Rows = field(default_factory=lambda: Rows(3, 3))
    _increments: Rows = field(default_factory=lambda: Rows(3))
    _base: Base | None = None
    _waiting: list[tuple[int, Array]] = field(default_factory=list)
    _stretches: list[Stretch] = field(default_factory=list)

    @property
    def poses(self) -> Rows:
        """The pose of every scan in its area."""
        self._settle()
        return self._poses

    @property
    def covariances(self) -> Rows:
        """Covariances (3, 3) of their invariant errors."""
        self._settle()
        return self._covariances

    @property
    def increments(self) -> Rows:
        """The odometry since the last key scan, zero at a key scan."""
        self._settle()
        return self._increments

    def key(self, stamp_ns: int, area: int, V: StochasticMap, motion: Motion | None = None) -> None:
        """A scan that the filter used: the robot's estimate after it, in its area.

        `motion` is the odometry since the last key scan, as the filter predicted by it.
        """
        base = Base(stamp_ns, area, V.robot.copy(), invariant_covariance(V))
        if self._base is None or motion is None:
            self._settle()
            self._append(base.pose, base.covariance, _STANDING)
        else:
            increments = [increment for _, increment in self._waiting]
            self._stretches.append(Stretch(self._base, base, motion, increments))
            for stamp, _ in self._waiting:
                self.stamps_ns.append(stamp)
                self.area.append(self._base.area)
            self._waiting = []
        self.key_at.append(len(self.stamps_ns))
        self.stamps_ns.append(stamp_ns)
        self.area.append(area)
        self._base = base
        if len(self._stretches) >= AT_ONCE:
            self._settle()

    def enter(self, area: int, V: StochasticMap) -> None:
        """The robot, where it is, is now in another area: what follows starts from there."""
        assert self._base is not None
        self._base = Base(self._base.stamp_ns, area, V.robot.copy(), invariant_covariance(V))

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
            self._settle()
            for stamp, increment in self._waiting:
                motion = carry(increment)
                pose = se2.compose(base.pose, motion.pose)
                Ad = se2.adjoint(pose)
                C = base.covariance + Ad @ motion.covariance @ Ad.T
                self.stamps_ns.append(stamp)
                self.area.append(base.area)
                self._append(pose, C, increment)
            self._waiting = []

    def _append(self, pose: Array, C: Array, increment: Array) -> None:
        self._poses.append(pose)
        self._covariances.append(C)
        self._increments.append(increment)

    def _settle(self) -> None:
        """Place the scans of all stretches."""
        if self._stretches:
            poses, C, increments = placed(self._stretches)
            self._poses.extend(poses)
            self._covariances.extend(C)
            self._increments.extend(increments)
            self._stretches = []


def placed(stretches: list[Stretch]) -> tuple[Array, Array, Array]:
    """Poses (n, 3), covariances (n, 3, 3) and increments (n, 3) of all scans of stretches.

    Odometry carries each scan in between from the stretch's start; what then remains at its end
    is shared out by how far each has come. The noise in between is that of a bridge held at both
    ends. The key scan at the end is the last of its stretch, with an increment of zero.
    """
    start = np.array([s.start.pose for s in stretches])
    end = np.array([s.end.pose for s in stretches])
    C_start = np.array([s.start.covariance for s in stretches])
    C_end = np.array([s.end.covariance for s in stretches])
    motion = np.array([s.motion.pose for s in stretches])
    Q = np.array([s.motion.covariance for s in stretches])
    rest = se2.log(se2.compose(end, se2.invert(se2.compose(start, motion))))
    Ad = se2.adjoint(end)
    bridge = Ad @ Q @ Ad.transpose(0, 2, 1)

    count = np.array([len(s.increments) for s in stretches])
    of = np.repeat(np.arange(len(stretches)), count)
    now = np.array([increment for s in stretches for increment in s.increments]).reshape(-1, 3)
    f = np.clip(_progress(now) / np.maximum(_progress(motion), 1e-9)[of], 0.0, 1.0)
    carried = se2.compose(start[of], now)
    g = f[:, None, None]

    last = np.cumsum(count + 1) - 1
    between = np.ones(len(of) + len(stretches), dtype=bool)
    between[last] = False
    poses, increments = np.empty((len(between), 3)), np.zeros((len(between), 3))
    C = np.empty((len(between), 3, 3))
    poses[last], C[last] = end, C_end
    poses[between] = se2.compose(se2.exp(f[:, None] * rest[of]), carried)
    C[between] = (1.0 - g) * C_start[of] + g * C_end[of] + g * (1.0 - g) * bridge[of]
    increments[between] = now
    return poses, C, increments


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
