"""The tree of frames of a log, and the laser's mount out of it."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.logs.records import Mount

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hiermap_cli.logs.records import Transform

    Array = NDArray[np.float64]

SAME_METRES = 0.005  # two tellings of one edge that differ by less are the same
SAME_RADIANS = 0.01
TILT_WARNING = math.radians(3.0)


class MountFound(NamedTuple):
    """A mount with what must be said about it."""

    mount: Mount
    warnings: list[str]


class FrameTree:
    """Edges `parent -> child`, of which the last telling counts, as in ROS's own buffer."""

    def __init__(self, edges: Iterable[Transform]) -> None:
        self._edges: dict[tuple[str, str], list[Array]] = {}
        for edge in edges:
            matrix = transform_matrix(edge)
            if matrix is not None:
                key = (frame_name(edge.parent), frame_name(edge.child))
                self._edges.setdefault(key, []).append(matrix)

    def frames(self) -> set[str]:
        """Names of all frames in the tree."""
        return {name for key in self._edges for name in key}

    def without_moving(self) -> FrameTree:
        """The tree without the edges whose tellings differ."""
        tree = FrameTree(())
        tree._edges = {
            key: [tellings[-1]]
            for key, tellings in self._edges.items()
            if all(_same(tellings[0], other) for other in tellings[1:])
        }
        return tree

    def joined(self, other: FrameTree) -> FrameTree:
        """The edges of both trees; the other's tellings come last."""
        tree = FrameTree(())
        tree._edges = {key: list(tellings) for key, tellings in self._edges.items()}
        for key, tellings in other._edges.items():
            tree._edges.setdefault(key, []).extend(tellings)
        return tree

    def connects(self, start: str, goal: str) -> bool:
        """Whether a path of edges leads from one frame to the other."""
        return start == goal or self._path(start, goal) is not None

    def mount(self, base: str, laser: str) -> MountFound | None:
        """The laser's frame seen from the robot's, composed along the edges; None if apart."""
        base, laser = frame_name(base), frame_name(laser)
        if base == laser:
            return MountFound(Mount(), [])
        path = self._path(base, laser)
        if path is None:
            return None
        T_b_s = np.eye(4)
        warnings = []
        for a, b in pairwise(path):
            key, forward = ((a, b), True) if (a, b) in self._edges else ((b, a), False)
            tellings = self._edges[key]
            T_a_b = tellings[-1] if forward else np.linalg.inv(tellings[-1])
            T_b_s = T_b_s @ T_a_b
            if not all(_same(tellings[0], other) for other in tellings[1:]):
                warnings.append(
                    f"the transform {key[0]} -> {key[1]} is given {len(tellings)} times and "
                    "differs: the last one is used; give --mount to override it"
                )
        mount, tilt = planar_mount(T_b_s)
        if tilt > TILT_WARNING:
            warnings.append(
                f"the laser is tilted by {math.degrees(tilt):.1f} degrees out of the plane; "
                "its ranges are used as if it were level"
            )
        return MountFound(mount, warnings)

    def _path(self, start: str, goal: str) -> list[str] | None:
        neighbours: dict[str, list[str]] = {}
        for parent, child in self._edges:
            neighbours.setdefault(parent, []).append(child)
            neighbours.setdefault(child, []).append(parent)
        came: dict[str, str] = {start: start}
        queue = deque([start])
        while queue:
            frame = queue.popleft()
            if frame == goal:
                path = [goal]
                while path[-1] != start:
                    path.append(came[path[-1]])
                return path[::-1]
            for other in neighbours.get(frame, ()):
                if other not in came:
                    came[other] = frame
                    queue.append(other)
        return None


def frame_name(name: str) -> str:
    """A frame's name without ROS 1's leading slash."""
    return name.removeprefix("/")


def transform_matrix(edge: Transform) -> Array | None:
    """The edge as a matrix (4, 4); None where its numbers are no rotation and translation."""
    x, y, z, w = edge.rotation
    norm = x * x + y * y + z * z + w * w
    if not (math.isfinite(norm) and norm > 1e-6 and all(map(math.isfinite, edge.translation))):
        return None
    s = 2.0 / norm
    T = np.eye(4)
    T[:3, :3] = [
        [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)],
    ]
    T[:3, 3] = edge.translation
    return T


def planar_mount(T_b_s: Array) -> tuple[Mount, float]:
    """The mount in the plane, and the angle (radians) by which the laser leaves the plane.

    A laser whose z axis points down is flipped: it is level again after a roll of pi, and its
    beam at angle a then points to yaw - a.
    """
    yaw = math.atan2(T_b_s[1, 0], T_b_s[0, 0])
    flipped = bool(T_b_s[2, 2] < 0.0)
    tilt = math.acos(min(1.0, abs(float(T_b_s[2, 2]))))
    return Mount(_clean(T_b_s[0, 3]), _clean(T_b_s[1, 3]), _clean(yaw), flipped), tilt


def planar_pose(
    translation: tuple[float, float, float], rotation: tuple[float, float, float, float]
) -> tuple[float, float, float]:
    """`(x, y, theta)` of a pose in space; theta, not wrapped, is nan where the rotation is none."""
    x, y, z, w = rotation
    norm = x * x + y * y + z * z + w * w
    if not norm > 1e-6:
        return translation[0], translation[1], math.nan
    if x == 0.0 and y == 0.0:
        return translation[0], translation[1], 2.0 * math.atan2(z, w)
    theta = math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return translation[0], translation[1], theta


def _clean(value: float) -> float:
    """Rounded to a picometre or picoradian: the rest of a composition is no information."""
    return round(float(value), 12) + 0.0


def _same(T_a: Array, T_b: Array) -> bool:
    moved = np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])
    cosine = 0.5 * (np.trace(T_a[:3, :3].T @ T_b[:3, :3]) - 1.0)
    return bool(moved < SAME_METRES and cosine > math.cos(SAME_RADIANS))
