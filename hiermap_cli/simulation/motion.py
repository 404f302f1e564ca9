"""How the robot drives: from way points to its true pose at any moment.

The way is made of straight lines, arcs that round off a way point where the robot does not stop,
and turns on the spot. Along each unbroken stretch the speed rises and falls within the robot's
acceleration. Everything is closed-form in the way s (metres, or radians on the spot), and s is a
function of time whose acceleration is constant from knot to knot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.se2 import compose, exp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.simulation.spec import RobotSpec, WayPointSpec

    Array = NDArray[np.float64]

_STEP = 0.02  # metres or radians between the knots of s(t)
_LEAST_RADIUS = 0.05  # metres; a tighter arc is a turn on the spot
_MOST_ARC = 2.1  # radians; what turns more is turned on the spot
_LEAST_TURN = 1e-9  # radians
_LEAST_SPEED = 1e-6  # between two halts, against rounding


@dataclass(frozen=True, slots=True)
class Leg:
    """A stretch of the journey between two moments at which the robot is carried.

    knots_t, knots_s, knots_v: (K,) seconds from the start, the way s and its speed there.
    piece_s: (P,) s at which each piece begins; piece_pose: (P, 3) the pose there, world frame;
    piece_twist: (P, 3) body velocity per unit of s: [1, 0, w] driving, [0, 0, +-1] on the spot.
    arrivals: (n, 2) seconds at which each way point of the leg is reached and left.
    """

    knots_t: Array
    knots_s: Array
    knots_v: Array
    piece_s: Array
    piece_pose: Array
    piece_twist: Array
    arrivals: Array

    @property
    def begin(self) -> float:
        """Seconds from the start."""
        return float(self.knots_t[0])

    @property
    def end(self) -> float:
        """Seconds from the start."""
        return float(self.knots_t[-1])

    def poses(self, seconds: Array) -> Array:
        """Poses (..., 3) in the world frame; before and after the leg those of its ends."""
        s = self.way(seconds)
        piece = np.clip(np.searchsorted(self.piece_s, s, side="right") - 1, 0, None)
        run = (s - self.piece_s[piece])[..., None] * self.piece_twist[piece]
        return compose(self.piece_pose[piece], exp(run))

    def way(self, seconds: Array) -> Array:
        """The way s at moments (...,)."""
        t, s, v = self.knots_t, self.knots_s, self.knots_v
        if len(t) == 1:
            return np.full(np.shape(seconds), s[0])
        k = np.clip(np.searchsorted(t, seconds, side="right") - 1, 0, len(t) - 2)
        lasts = t[k + 1] - t[k]
        since = np.clip(seconds - t[k], 0.0, lasts)
        rise = np.divide(v[k + 1] - v[k], lasts, out=np.zeros_like(lasts), where=lasts > 0.0)
        return np.minimum(s[k] + (v[k] + 0.5 * rise * since) * since, s[k + 1])


class _Route:
    """Pieces of a way as they are laid one behind the other."""

    def __init__(self, pose: Array) -> None:
        self.pose = np.array(pose, dtype=float)
        self.starts: list[float] = []
        self.poses: list[Array] = []
        self.twists: list[tuple[float, float, float]] = []
        self.s = 0.0
        # Stretches that end standing: (s at the end, seconds to wait there).
        self.halts: list[tuple[float, float]] = []
        self.marks: list[float] = []  # s of each way point

    def lay(self, length: float, twist: tuple[float, float, float]) -> None:
        if length <= _LEAST_TURN:
            return
        self.starts.append(self.s)
        self.poses.append(self.pose)
        self.twists.append(twist)
        self.pose = compose(self.pose, exp(length * np.array(twist)))
        self.s += length

    def halt(self, seconds: float) -> None:
        self.halts.append((self.s, seconds))

    def turn_to(self, heading: float) -> None:
        angle = math.remainder(heading - float(self.pose[2]), 2.0 * math.pi)
        if angle < _LEAST_TURN - math.pi:  # a turn right round goes left, whatever the last bit
            angle = math.pi
        self.lay(abs(angle), (0.0, 0.0, math.copysign(1.0, angle)))


def drive(
    start: Array,
    points: Sequence[WayPointSpec],
    robot: RobotSpec,
    begin: float = 0.0,
    stand: float = 0.0,
) -> Leg:
    """The leg from a pose through way points, `begin` seconds after the start.

    Args:
        start: (3,) where the robot stands.
        points: the way points still to be reached, in order; none leaves it standing.
        robot: its limits of speed and acceleration.
        begin: seconds.
        stand: seconds that the robot stands before it drives off.
    """
    route = _Route(start)
    route.halt(stand)
    targets = [np.array(point.at) for point in points]
    for index, (point, target) in enumerate(zip(points, targets, strict=True)):
        here = route.pose[:2]
        onward = targets[index + 1] if index + 1 < len(targets) else None
        distance = math.dist(here, target)
        if distance > _LEAST_TURN:
            heading = math.atan2(target[1] - here[1], target[0] - here[0])
            if abs(math.remainder(heading - float(route.pose[2]), 2.0 * math.pi)) > _LEAST_TURN:
                route.halt(0.0)
                route.turn_to(heading)
                route.halt(0.0)
        arc = None if point.stop > 0.0 else _rounding(here, target, onward, robot)
        if arc is None:
            route.lay(distance, (1.0, 0.0, 0.0))
            route.halt(point.stop)
            route.marks.append(route.s)
            continue
        radius, angle, tangent = arc
        route.lay(distance - tangent, (1.0, 0.0, 0.0))
        length = radius * abs(angle)
        route.marks.append(route.s + 0.5 * length)
        route.lay(length, (1.0, 0.0, math.copysign(1.0 / radius, angle)))
    route.halt(0.0)
    return _timed(route, robot, begin)


def _rounding(
    here: Array, target: Array, onward: Array | None, robot: RobotSpec
) -> tuple[float, float, float] | None:
    """Radius, angle and tangent length of the arc at `target`; None where the robot must stop."""
    if onward is None:
        return None
    length_in, length_out = math.dist(here, target), math.dist(target, onward)
    if min(length_in, length_out) <= _LEAST_TURN:
        return None
    angle = math.remainder(
        math.atan2(onward[1] - target[1], onward[0] - target[0])
        - math.atan2(target[1] - here[1], target[0] - here[0]),
        2.0 * math.pi,
    )
    if abs(angle) <= _LEAST_TURN:
        return (1.0, 0.0, 0.0)
    if abs(angle) > _MOST_ARC:
        return None
    slope = math.tan(0.5 * abs(angle))
    # Half of the next stretch at most, so that the next way point has room for its own arc.
    tangent = min(robot.turn_radius * slope, length_in, 0.5 * length_out)
    radius = tangent / slope
    return None if radius < _LEAST_RADIUS else (radius, angle, tangent)


def _timed(route: _Route, robot: RobotSpec, begin: float) -> Leg:
    """The route with its timing: s(t) by forward and backward passes of the acceleration."""
    piece_s = np.array([*route.starts, route.s])
    twists = np.array([*route.twists, (0.0, 0.0, 0.0)], dtype=float)
    poses = np.array([*route.poses, route.pose], dtype=float)
    marks = np.array(route.marks)
    knots_t, knots_s, knots_v = [np.array([begin])], [np.zeros(1)], [np.zeros(1)]
    now, s_from = begin, 0.0
    for s_to, wait in route.halts:
        if s_to > s_from:
            s = _grid(s_from, s_to, np.concatenate((piece_s, marks)))
            v = _speeds(s, piece_s, twists, robot)
            seconds = now + np.cumsum(2.0 * np.diff(s) / (v[1:] + v[:-1]))
            knots_t.append(seconds)
            knots_s.append(s[1:])
            knots_v.append(v[1:])
            now, s_from = float(seconds[-1]), s_to
        if wait > 0.0:
            now += wait
            knots_t.append(np.array([now]))
            knots_s.append(np.array([s_to]))
            knots_v.append(np.zeros(1))
    t, s = np.concatenate(knots_t), np.concatenate(knots_s)
    reached, left = np.searchsorted(s, marks, "left"), np.searchsorted(s, marks, "right") - 1
    arrivals = np.column_stack((t[reached], t[left]))
    return Leg(t, s, np.concatenate(knots_v), piece_s, poses, twists, arrivals)


def _grid(s_from: float, s_to: float, among: Array) -> Array:
    """Knots from one halt to the next, evenly spaced and at each of `among` between them."""
    count = max(2, math.ceil((s_to - s_from) / _STEP))
    grid = np.linspace(s_from, s_to, count + 1)
    inner = among[(among > s_from) & (among < s_to)]
    return np.union1d(grid, inner)


def _speeds(s: Array, piece_s: Array, twists: Array, robot: RobotSpec) -> Array:
    """Speed (K,) at each knot, from standing at s[0] to standing at s[-1].

    v^2 is bounded at every knot by the piece's own limit and by what the acceleration allows
    from every other knot: v^2(i) <= v^2(j) + 2 a |s_i - s_j|, a running minimum in both
    directions.
    """
    middle = 0.5 * (s[1:] + s[:-1])
    piece = np.searchsorted(piece_s, middle, side="right") - 1
    driving, turning = twists[piece, 0] != 0.0, np.abs(twists[piece, 2])
    on_the_spot = not driving.any()
    limit = np.full(len(piece), robot.turn_rate if on_the_spot else robot.speed)
    if not on_the_spot:
        bent = turning > 0.0
        limit[bent] = np.minimum(robot.speed, robot.turn_rate / turning[bent])
    a = robot.turn_acceleration if on_the_spot else robot.acceleration
    v2 = np.square(np.minimum(np.append(limit, np.inf), np.append(np.inf, limit)))
    v2[0] = v2[-1] = 0.0
    v2 = np.minimum.accumulate(v2 - 2.0 * a * s) + 2.0 * a * s
    v2 = np.minimum.accumulate((v2 + 2.0 * a * s)[::-1])[::-1] - 2.0 * a * s
    speeds: Array = np.sqrt(np.maximum(v2, _LEAST_SPEED**2))
    speeds[0] = speeds[-1] = 0.0
    return speeds
