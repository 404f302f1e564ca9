"""Ends of beams that were on people: what another scan has seen through does not persist.

A robot among people has ends of beams all about its path. What is no wall is gone some steps
later, or was not there before: a scan from nearby has then seen through the place. Corners and
jambs are hidden or seen past at a hair's breadth; only where all beams about go past it, well
beyond, was nothing there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.mapping.topology.near_ends import NearEnds

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]

SCANS = 2  # before this one, that are compared with it
BEYOND = 0.3  # metres that beams go on behind a place that is free
APART = 0.3  # radians: the widest gap between beams that tell what lies between them
OVER = 0.22  # metres from the path: what stands there is in the robot's way
ABOUT = 8  # beams that must all go past


class Look(NamedTuple):
    """A scan: the laser's place (2,), bearings (n,) of its beams, as they grow, less `heading`.

    past: (n + 1,) how far a place between two beams (by the number of beams before it) is seen
    past by all eight about it, zero where it is not. points: (m, 2) the ends of beams that are
    compared, and `at`: where they lie in `NearEnds`. gone: metres of what stands about the robot
    that were there in one of the scans before and are not in this one, or the other way round.
    """

    origin: Array
    heading: float
    bearing: Array
    past: Array
    points: Array
    at: int
    gone: float = 0.0


def looked(origin: Array, ends: Array, points: Array, at: int = 0) -> Look:
    """A scan with its ends (n, 2), some of which are `points`, in one frame."""
    d = ends - origin
    bearing = np.arctan2(d[:, 1], d[:, 0])
    order = bearing.argsort()
    bearing = bearing[order]
    r = np.hypot(d[:, 0], d[:, 1])[order]
    past = np.zeros(len(r) + 1)
    if len(r) >= ABOUT:
        two = np.minimum(r[1:], r[:-1])
        four = np.minimum(two[2:], two[:-2])
        least = np.minimum(four[4:], four[:-4])
        dense = bearing[ABOUT - 1 :] - bearing[: 1 - ABOUT] < APART
        past[ABOUT // 2 : -(ABOUT // 2)] = np.maximum(least - BEYOND, 0.0) * dense
    return Look(origin, 0.0, bearing, past, points, at)


def seen_through(look: Look, points: Array) -> Mask:
    """Which of the points (m, 2) the scan has looked through, with all beams about them.

    Nothing is told of the few beams about where bearings begin anew.
    """
    x, y = points[:, 0] - look.origin[0], points[:, 1] - look.origin[1]
    bearing = np.arctan2(y, x)
    if look.heading:
        bearing = se2.wrap(bearing - look.heading)
    far = look.past.take(look.bearing.searchsorted(bearing))
    return np.asarray(far * far > x * x + y * y)


def surface(look: Look, points: Array) -> float:
    """Metres that the beams of a scan cover where they end at these points (n, 2)."""
    step = (look.bearing[-1] - look.bearing[0]) / (len(look.bearing) - 1)
    return float(step * np.hypot(*(points - look.origin).T).sum())


def moved(looks: Sequence[Look], R_b_a: Array) -> list[Look]:
    """Scans in another frame, from which the present one is seen as `R_b_a` (3,)."""
    turn = se2.rotation(R_b_a[2]).T
    return [
        look._replace(
            origin=R_b_a[:2] + look.origin @ turn,
            points=R_b_a[:2] + look.points @ turn,
            heading=look.heading + float(R_b_a[2]),
        )
        for look in looks
    ]


def gone_over(points: Array, way: Array) -> Mask:
    """Which of the points (n, 2) are so near the robot's own (m, 2) that it went over them."""
    far2 = np.square(way).sum(axis=1) - 2.0 * (points @ way.T)
    return np.asarray(far2.min(axis=1) + np.square(points).sum(axis=1) < OVER * OVER)


def went_over(point: Array, way: Array) -> bool:
    """`gone_over` of one point (2,), without the cost of a product of matrices."""
    x, y = way[:, 0] - point[0], way[:, 1] - point[1]
    return bool((x * x + y * y).min() < OVER * OVER)


@dataclass(slots=True)
class Passers:
    """Compares each scan with the last ones before it, both ways."""

    _looks: list[Look] = field(default_factory=list)

    def persisting(
        self, origin: Array, ends: Array, points: Array, near: NearEnds
    ) -> tuple[Array, Look]:
        """Those of a scan's `points` that no scan before has seen through, and the scan itself.

        Points of the scans before, told to `near` at last, that are now seen through are taken
        out of it. Of scans that told none, none is asked.
        """
        now = looked(origin, ends, points, near.position())
        gone, metres = np.zeros(len(points), dtype=bool), 0.0
        for look in self._looks:
            gone |= seen_through(look, points)
            passed = seen_through(now, look.points)
            if passed.any():
                near.blank(look.at, passed)
                metres += surface(look, look.points[passed])
        if gone.any():
            metres += surface(now, points[gone])
            points = points[~gone]
        self._looks = [*self._looks, now._replace(points=points)][-SCANS:]
        return points, now._replace(points=points[:0], gone=metres)

    def forget(self) -> None:
        """The scans before are told no more."""
        self._looks = []

    def move(self, R_b_a: Array) -> None:
        """Into another frame, from which the present one is seen as `R_b_a` (3,)."""
        self._looks = moved(self._looks, R_b_a)
