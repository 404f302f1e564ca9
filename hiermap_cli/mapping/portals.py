"""Portals: where two areas touch, and when the robot goes through one that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from hiermap_cli.estimation.stochastic_map import clone_robot
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, AreaMap, Features, joined

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

# A door or opening that people see; a way between areas that no door explains; a place of one
# area that was begun anew before it was known again; a cut for size; no way at all, but that the
# robot was lost in the one and began the other.
PortalKind = Literal["door", "open", "same", "size", "lost"]

ASIDE = 0.35  # metres beside the jambs that the robot's path through a door may seem to be


@dataclass(frozen=True, slots=True)
class Portal:
    """Where two areas touch: an anchor in each (one place), and where the door lies from it.

    R_anchor_d: (3,) the door's frame from the anchor: origin midway between the jambs, X along
    them, Y from area `a` to area `b`. width: metres between the jambs as passed. wall, open:
    metres of the jambs' line that are wall, and that beams have passed, both sides together.
    """

    a: int
    anchor_a: int
    b: int
    anchor_b: int
    kind: PortalKind
    R_anchor_d: Array
    width: float
    wall: float
    open: float
    crossings: int = 1


def add_anchor(area: AreaMap, key: int) -> tuple[AreaMap, int]:
    """The area with the robot's present pose as an object; returns its uid.

    It is a copy of the robot, fully correlated with it: where the next area's frame hangs.
    """
    V = clone_robot(area.V)
    one = np.ones(1, dtype=np.int64)
    new = Features(
        uid=one * area.next_uid, kind=one * ANCHOR, wall=-one, side=0 * one,
        lo=np.zeros(1), hi=np.zeros(1), seen=one, last=one * key,
    )  # fmt: skip
    return AreaMap(V, joined(area.features, new), area.next_uid + 1), area.next_uid


def adrift(area: AreaMap, key: int, sigma: float, sigma_angle: float) -> tuple[AreaMap, int]:
    """As `add_anchor`, for a place that may lie anywhere about the robot, by these deviations."""
    area, uid = add_anchor(area, key)
    V, where = area.V, area.V.columns(area.V.objects)
    spread = np.diag(np.square([sigma, sigma, sigma_angle]))
    Ad = V.error_D_tangent(V.robot)
    P = V.covariance.copy()
    P[where, where] += Ad @ spread @ Ad.T
    return area._replace(V=V._replace(covariance=P)), uid


def anchor_index(area: AreaMap, uid: int) -> int:
    """Where an anchor stands among V's poses (the robot is 0)."""
    return 1 + int(np.flatnonzero(area.features.uid == uid)[0])


def door_frame(area: AreaMap, portal: Portal, *, from_a: bool) -> Array:
    """R_A_d: (3,) the portal's door in the frame of one of its areas."""
    uid = portal.anchor_a if from_a else portal.anchor_b
    frame: Array = se2.compose(area.V.poses[anchor_index(area, uid)], portal.R_anchor_d)
    return frame


def reached(portals: Sequence[Portal], area: int, kinds: Sequence[PortalKind]) -> set[int]:
    """The areas that portals of these kinds join to one, over others too; and itself."""
    joins = [(p.a, p.b) for p in portals if p.kind in kinds]
    found, grown = {area}, True
    while grown:
        more = {there for a, b in joins for here, there in ((a, b), (b, a)) if here in found}
        grown = not more <= found
        found |= more
    return found


@dataclass(slots=True)
class KnownDoors:
    """Watches the doors of one area for the robot's going out by one of them."""

    hysteresis: float
    _portal: list[int] = field(default_factory=list)
    _frame: Array = field(default_factory=lambda: np.zeros((0, 3)))
    _sign: Array = field(default_factory=lambda: np.zeros(0))
    _half: list[float] = field(default_factory=list)
    _line: list[tuple[float, ...]] = field(default_factory=list)
    _before: list[tuple[float, float]] | None = None
    _passed: set[int] = field(default_factory=set)

    def set(self, area: int, areas: Sequence[AreaMap], portals: Sequence[Portal]) -> None:
        """Watch the doors of this area from now on."""
        sides = [
            (i, p, from_a)
            for i, p in enumerate(portals)
            for from_a in (True, False)
            if p.kind in ("door", "size") and (p.a if from_a else p.b) == area
        ]
        self._portal = [i for i, _, _ in sides]
        self._sign = np.array([1.0 if from_a else -1.0 for _, _, from_a in sides])
        self._half = [0.5 * p.width + ASIDE for _, p, _ in sides]
        frames = [door_frame(areas[area], p, from_a=from_a) for _, p, from_a in sides]
        self._frame = np.array(frames).reshape(-1, 3)
        self._line = [
            (x, y, math.cos(theta), math.sin(theta), sign)
            for (x, y, theta), sign in zip(self._frame.tolist(), self._sign.tolist(), strict=True)
        ]
        self._before = None
        self._passed = set()

    def rewatch(self, poses: Sequence[Array]) -> None:
        """The robot has come by these poses, and not as was seen."""
        self._before, self._passed = None, set()
        self.replay(poses)

    def replay(self, poses: Sequence[Array]) -> None:
        """The way by which the robot has come, where it is in the area since before now."""
        for pose in poses:
            self.gone_through(pose)

    def gone_through(self, pose: Array) -> int | None:
        """The portal by which the robot, now at `pose`, has left the area, if it has."""
        if not self._portal:
            return None
        x, y, _ = pose.tolist()
        now = [
            (c * (x - x0) + s * (y - y0), sign * (c * (y - y0) - s * (x - x0)))
            for x0, y0, c, s, sign in self._line
        ]
        before, self._before = self._before, now
        if before is None:
            return None
        for i, ((u0, v0), (u, v)) in enumerate(zip(before, now, strict=True)):
            if v <= 0.0:
                self._passed.discard(i)
            elif v0 <= 0.0 and abs(u0 + v0 / (v0 - v) * (u - u0)) < self._half[i]:
                self._passed.add(i)
        for k in sorted(self._passed):
            if now[k][1] > self.hysteresis:
                return self._portal[k]
        return None

    def leads_out(self, frame: Array, distance: float = 0.8) -> bool:
        """Whether a known door lies about there and leads out of the area in that direction.

        Where a door was found only on the way back, the area is on both sides of it; who goes
        through it the other way leaves the area by a door that is new.
        """
        apart = np.hypot(*(self._frame[:, :2] - frame[:2]).T)
        alike = self._sign * np.cos(self._frame[:, 2] - frame[2]) > 0.6
        return bool(np.any((apart < distance) & alike))
