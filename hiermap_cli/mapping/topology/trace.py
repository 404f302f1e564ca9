"""The last metres of the robot's path, and what it saw from there."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.topology.near_ends import NearEnds
from hiermap_cli.mapping.topology.passers import Look, Passers, moved

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from hiermap_cli.perception.sight import Sight

    Array = NDArray[np.float64]

NEAR = 3.0  # metres: ends nearer than this to the laser tell the width of the path
KEPT = 5.0  # metres of path that are remembered
MOST = 150  # scans that are remembered
APART, APART_ANGLE = 0.08, 0.1  # metres or radians between scans that are remembered
NEAR_APART = 0.3  # metres and radians, together, between scans whose ends tell the width


@dataclass(slots=True)
class Trace:
    """The last metres of the path and what was seen from there, in the frame of the area.

    keys, sights: the key scans, and what they saw in the robot's own frame. near: ends that tell
    the width of the path. looks: where the scans they are of looked through. way: where the robot
    was, a point a scan.
    """

    travelled: list[float] = field(default_factory=list)
    turned: list[float] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    origins: list[Array] = field(default_factory=list)
    ends: list[Array] = field(default_factory=list)
    keys: list[int] = field(default_factory=list)
    sights: list[Sight] = field(default_factory=list)
    near: NearEnds = field(default_factory=NearEnds)
    looks: list[tuple[Look, ...]] = field(default_factory=list)
    way: NearEnds = field(default_factory=NearEnds)
    length: float = 0.0
    fresh: int = 0  # of the last scans: not yet taken by `older`
    entered: float = 0.0  # metres of path at which it came into the present area
    _told: tuple[float, float] = (-np.inf, 0.0)
    _passers: Passers = field(default_factory=Passers)

    def add(self, pose: Array, step: float, sight: Sight, key: int = -1) -> None:
        """Scan number `key` taken at `pose` (3,), `step` metres of path after the last one."""
        self.length += step
        turn_so_far = 0.0
        if self.poses:
            turned = abs(se2.wrap_one(float(pose[2] - self.poses[-1][2])))
            if self.length - self.travelled[-1] < APART and turned < APART_ANGLE:
                return
            turn_so_far = self.turned[-1] + turned
        c, s = math.cos(pose[2]), math.sin(pose[2])
        turn = np.array([[c, s], [-s, c]])
        origin = pose[:2] + sight.origin @ turn
        ends = pose[:2] + sight.ends @ turn
        self.travelled.append(self.length)
        self.turned.append(turn_so_far)
        self.poses.append(pose)
        self.origins.append(origin)
        self.ends.append(ends)
        self.keys.append(key)
        self.sights.append(sight)
        near, looks = self._near(origin, ends, turn_so_far)
        self.near.append(near)
        self.looks.append(looks)
        self.way.append(pose[None, :2])
        self.fresh += 1
        old = 0
        while self.travelled[old] < self.length - KEPT or len(self.poses) - old > MOST:
            old += 1
        if old:
            for kept in self._every():
                del kept[:old]
            self.fresh = min(self.fresh, len(self.poses))

    def _near(self, origin: Array, ends: Array, turned: float) -> tuple[Array, tuple[Look, ...]]:
        """Ends near enough to tell the width of the path, of a scan that has some new to tell."""
        moved = self.length - self._told[0] + abs(turned - self._told[1])
        if moved < NEAR_APART:
            return ends[:0], ()
        self._told = (self.length, turned)
        d = ends - origin
        near = ends[d[:, 0] ** 2 + d[:, 1] ** 2 < NEAR * NEAR]
        points, look = self._passers.persisting(origin, ends, near, self.near)
        return points, (look,)

    def older(self, behind: float) -> list[int]:
        """Scans taken more than `behind` metres of path ago; each is told once."""
        first = len(self.poses) - self.fresh
        last = bisect_left(self.travelled, self.length - behind)
        if last <= first:
            return []
        self.fresh = len(self.poses) - last
        return list(range(first, last))

    def move(self, R_b_a: Array) -> None:
        """Into the frame of another area, seen from which the present one is `R_b_a`."""
        c, s = np.cos(R_b_a[2]), np.sin(R_b_a[2])
        turn = np.array([[c, s], [-s, c]])
        self.poses = [se2.compose(R_b_a, pose) for pose in self.poses]
        for kept in (self.origins, self.ends):
            kept[:] = [R_b_a[:2] + points @ turn for points in kept]
        self.near.move(R_b_a)
        self.way.move(R_b_a)
        self.looks = [tuple(moved(looks, R_b_a)) for looks in self.looks]
        self._passers.move(R_b_a)

    def drop(self, after: float) -> None:
        """Without the scans taken after that many metres of path."""
        keep = bisect_right(self.travelled, after)
        self._passers.forget()
        self.fresh = max(self.fresh - (len(self.poses) - keep), 0)
        for kept in self._every():
            del kept[keep:]

    def amend(self, poses: Mapping[int, Array]) -> float:
        """Where the robot was at the last key scans after all, by their numbers.

        Returns the metres of path at which that begins.
        """
        first = bisect_left(self.keys, min(poses))
        again = list(zip(self.travelled, self.keys, self.sights, strict=True))[first:]
        if not again:
            return self.length
        since = self.travelled[first - 1] if first else self.travelled[0] - APART
        length, fresh = self.length, self.fresh
        self.drop(since)
        self._told = (-np.inf, 0.0)
        for self.length, key, sight in again:
            self.add(poses[key], 0.0, sight, key)
        self.length, self.fresh = length, min(self.fresh, fresh)
        return since

    def _every(self) -> tuple[list[Any] | NearEnds, ...]:
        """All that is kept for each scan."""
        return (
            self.travelled, self.turned, self.poses, self.origins, self.ends, self.keys,
            self.sights, self.near, self.looks, self.way,
        )  # fmt: skip

    def at(self, s: float) -> tuple[Array, Array]:
        """The point (2,) of the path at `s` metres of it, and the way (2,) it goes there."""
        i = min(max(bisect_left(self.travelled, s), 1), len(self.poses) - 1)
        a, b = self.poses[i - 1][:2], self.poses[i][:2]
        span = self.travelled[i] - self.travelled[i - 1]
        f = (s - self.travelled[i - 1]) / span if span > 0 else 1.0
        way = b - a
        return a + min(max(f, 0.0), 1.0) * way, way

    def rays(self, start: float) -> tuple[Array, Array]:
        """Origins and ends (n, 2) of all beams since `start` metres of path."""
        first = int(np.searchsorted(self.travelled, start))
        counts = [len(ends) for ends in self.ends[first:]]
        return np.repeat(self.origins[first:], counts, axis=0), np.concatenate(self.ends[first:])
