"""What a laser could see of a reference map from the places where the robot was.

The trajectory tells where the robot was and which way it looked; walls and furniture of the
reference block the view. Neither the laser's reach nor its field of view is in a trajectory:
they are given, or unlimited.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry.se2 import wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_STEP = 0.25  # metres of path between two places from which the view is taken
_TURN = 0.35  # radians between them
_CHUNK = 2_000_000  # sight lines times walls tested at once


class View(NamedTuple):
    """Reach in metres and field of view in radians, symmetric about the robot's heading."""

    reach: float = math.inf
    field_of_view: float = 2.0 * math.pi


ALL_AROUND = View()


def viewpoints(poses: Array) -> Array:
    """Poses (V, 3) of a trajectory (N, 3), thinned to where the view changes."""
    if len(poses) == 0:
        return poses
    kept, last = [0], poses[0]
    for i, pose in enumerate(poses):
        moved = math.hypot(pose[0] - last[0], pose[1] - last[1])
        if moved >= _STEP or abs(math.remainder(pose[2] - last[2], 2.0 * math.pi)) >= _TURN:
            kept.append(i)
            last = pose
    return poses[kept]


def spread(poses: Array, size: int) -> list[Array]:
    """Poses (V, 3) in batches of about `size`, each spread over the whole trajectory.

    The first batch sees nearly everything, so that the rest is for what is still unseen.
    """
    batches = -(-len(poses) // size)
    return [poses[begin::batches] for begin in range(batches)]


def in_sight(
    views: Array, targets: Array, blockers: Array, view: View, margin: float = 0.02
) -> NDArray[np.bool_]:
    """Whether targets (T, 2) can be seen from poses (V, 3) past walls (W, 4): (V, T).

    A wall nearer than `margin` metres to the target on the line of sight does not hide it: it is
    what the target is part of.
    """
    seen = in_view(views, targets, view)
    for t, target in enumerate(targets):
        v = np.flatnonzero(seen[:, t])
        seen[v, t] = is_clear(views[v, :2], target, blockers, margin)
    return seen


def in_view(views: Array, targets: Array, view: View) -> NDArray[np.bool_]:
    """Whether targets (T, 2) lie within reach and field of view of poses (V, 3): (V, T)."""
    towards = targets[None, :, :] - views[:, None, :2]
    distance = np.hypot(towards[..., 0], towards[..., 1])
    bearing = np.arctan2(towards[..., 1], towards[..., 0]) - views[:, None, 2]
    return (distance <= view.reach) & (np.abs(wrap(bearing)) <= 0.5 * view.field_of_view + 1e-9)


def is_clear(
    origins: Array, target: Array, blockers: Array, margin: float = 0.02
) -> NDArray[np.bool_]:
    """Whether nothing of the segments (W, 4) stands between origins (K, 2) and a target (2,).

    What stands nearer than `margin` metres to the target does not hide it.
    """
    clear = np.ones(len(origins), dtype=bool)
    if len(blockers) == 0:
        return clear
    towards = target - origins
    distance = np.hypot(towards[:, 0], towards[:, 1])
    chunk = max(1, _CHUNK // len(blockers))
    for begin in range(0, len(origins), chunk):
        part = slice(begin, begin + chunk)
        direction = towards[part] / np.maximum(distance[part], 1e-12)[:, None]
        clear[part] = first_hits(origins[part], direction, blockers) >= distance[part] - margin
    return clear


def first_hits(origins: Array, directions: Array, blockers: Array) -> Array:
    """Distance (K,) along unit rays (K, 2) from (K, 2) to the first of the segments (W, 4).

    inf where none is hit; ends count as part of a segment, and rays along one do not hit it.
    """
    start, span = blockers[:, :2], blockers[:, 2:] - blockers[:, :2]
    apart = start[None, :, :] - origins[:, None, :]
    # origin + d * direction = start + s * span, solved by cross products
    cross = directions[:, None, 0] * span[None, :, 1] - directions[:, None, 1] * span[None, :, 0]
    parallel = np.abs(cross) < 1e-12
    safe = np.where(parallel, 1.0, cross)
    d = (apart[..., 0] * span[None, :, 1] - apart[..., 1] * span[None, :, 0]) / safe
    s = (apart[..., 0] * directions[:, None, 1] - apart[..., 1] * directions[:, None, 0]) / safe
    hit = ~parallel & (d >= 0.0) & (s >= -1e-9) & (s <= 1.0 + 1e-9)
    first: Array = np.min(np.where(hit, d, math.inf), axis=1, initial=math.inf)
    return first


def star(pose: Array, blockers: Array, view: View) -> Array:
    """The polygon (m, 2) that is seen from a pose (3,): exact, from rays at every segment's ends.

    `view.reach` must be finite or the pose enclosed by blockers (W, 4).
    """
    ends = blockers.reshape(-1, 2) - pose[:2]
    bearing = np.arctan2(ends[:, 1], ends[:, 0]) - pose[2]
    half = 0.5 * view.field_of_view
    # A ray to an end stops there; those beside it pass.
    angles = wrap(np.concatenate((bearing - 1e-6, bearing, bearing + 1e-6)))
    angles = np.unique(np.concatenate((angles[np.abs(angles) <= half], (-half, half))))
    reach = _reach(pose, angles, blockers, view.reach)
    if (reach == view.reach).any():  # the arc between rays that end by the reach alone
        angles = np.union1d(angles, np.linspace(-half, half, 73))
        reach = _reach(pose, angles, blockers, view.reach)
    heading = angles + pose[2]
    polygon: Array = pose[:2] + reach[:, None] * np.column_stack((np.cos(heading), np.sin(heading)))
    if view.field_of_view >= 2.0 * math.pi - 1e-9:
        return polygon
    return np.concatenate((pose[None, :2], polygon))


def _reach(pose: Array, angles: Array, blockers: Array, farthest: float) -> Array:
    """How far rays at angles (K,) from a pose's heading go, (K,)."""
    heading = angles + pose[2]
    directions = np.column_stack((np.cos(heading), np.sin(heading)))
    origins = np.broadcast_to(pose[:2], directions.shape)
    return np.minimum(first_hits(origins, directions, blockers), farthest)
