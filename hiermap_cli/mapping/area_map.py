"""The stochastic map of an area: the robot, and the walls and wall ends seen from it.

Every object is a pose R_a_l (section 5.2). A *wall* has its X axis along the line, the free side
on its left, and binds y and theta; its x is a convention. An *end* lies on a wall where that
wall begins or ends, and binds x, y and theta, of which y and theta are its wall's: it is born
with them, and only its x is measured. So each segment of a scan enters once, through its wall,
and each end once; nothing is counted twice. Corners, doors and corridors are groups of these
(see `landmarks`): two landmarks that share a wall are correlated through it, exactly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.stochastic_map import (
    StochasticMap,
    add_objects,
    augment,
    remove_objects,
    seen_from_robot,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

WALL, END, ANCHOR = 0, 1, 2
_ONE = np.eye(3)


class Features(NamedTuple):
    """What is kept of each object beside the state; n objects.

    uid: (n,) never reused within an area. kind: WALL, END or ANCHOR. wall: (n,) uid of an end's
    wall, else -1. side: (n,) 0 for a wall's p1 end, 1 for its p2 end. lo, hi: (n,) extent of a
    wall along its X axis. seen: (n,) observations. last: (n,) key scan of the last one.
    """

    uid: Index
    kind: Index
    wall: Index
    side: Index
    lo: Array
    hi: Array
    seen: Index
    last: Index


_NO_INTEGERS, _NO_REALS = np.zeros(0, dtype=np.int64), np.zeros(0)
EMPTY = Features(
    uid=_NO_INTEGERS, kind=_NO_INTEGERS, wall=_NO_INTEGERS, side=_NO_INTEGERS,
    lo=_NO_REALS, hi=_NO_REALS, seen=_NO_INTEGERS, last=_NO_INTEGERS,
)  # fmt: skip


class Glimpse(NamedTuple):
    """An end seen once: uid of its wall, its side, x along the wall, key scan."""

    wall: int
    side: int
    x: float
    key: int


class AreaMap(NamedTuple):
    """V and C(V) of one area and its features; `next_uid` is the next free uid.

    glimpsed: ends seen once, which are not in V yet. Most of them are seen never again.
    """

    V: StochasticMap
    features: Features
    next_uid: int = 0
    glimpsed: tuple[Glimpse, ...] = ()

    def with_map(self, V: StochasticMap) -> AreaMap:
        """The same features, estimated otherwise."""
        return AreaMap(V, self.features, self.next_uid, self.glimpsed)


def add_walls(area: AreaMap, view: SegmentView, segments: Index, key: int) -> AreaMap:
    """New walls (equation 2), each with its frame at the segment's centre."""
    if not len(segments):
        return area
    V, k = area.V, len(segments)
    centre, theta = view.centre.take(segments, axis=0), view.theta.take(segments)
    c, s = np.cos(theta), np.sin(theta)
    R_r_l = np.empty((k, 3))
    R_r_l[:, :2], R_r_l[:, 2] = centre, theta
    C = np.zeros((k, 3, 3))
    C[:, 0, 0] = np.square(np.maximum(0.5 * view.length.take(segments), 0.5))
    C[:, 1, 1], C[:, 2, 2] = view.var_y.take(segments), view.var_theta.take(segments)
    V = add_objects(V, R_r_l, C)
    from_centre = view.ends.take(segments, axis=0) - centre[:, None]
    along = c[:, None] * from_centre[..., 0] + s[:, None] * from_centre[..., 1]
    new = Features(
        uid=area.next_uid + np.arange(k),
        kind=np.array([WALL] * k),
        wall=np.array([-1] * k),
        side=np.zeros(k, dtype=np.int64),
        lo=along[:, 0],
        hi=along[:, 1],
        seen=np.array([1] * k),
        last=np.array([key] * k),
    )
    return AreaMap(V, joined(area.features, new), area.next_uid + k, area.glimpsed)


def add_ends(
    area: AreaMap, walls: Index, x: Array, sigma: Array, sides: Index, key: int
) -> AreaMap:
    """New ends on walls (object indices), at x (k,) along each, measured with `sigma` (k,).

    An end's y and theta errors are its wall's, its x error is the robot's plus the noise of the
    measurement: the line itself is not used a second time.
    """
    if not len(walls):
        return area
    V = area.V
    k, start = len(walls), V.first_object
    X_w = V.poses.take(1 + walls, axis=0)
    X = X_w.copy()
    c, s = np.cos(X_w[:, 2]), np.sin(X_w[:, 2])
    X[:, 0] += c * x
    X[:, 1] += s * x
    # Of an error at the end (its X axis u, in the invariant error, and the row of Ad(X^-1) that
    # gives its x), the part along the wall is the robot's, the rest is the wall's.
    u = np.zeros((k, 3, 1))
    u[:, 0, 0], u[:, 1, 0] = c, s
    row = np.empty((k, 1, 3))
    row[:, 0, 0], row[:, 0, 1], row[:, 0, 2] = c, s, s * X[:, 0] - c * X[:, 1]
    along = u @ row
    A = np.zeros((k, 3, start + 3 * k))
    A[:, :, :3] = V.by_error(along, V.robot)
    across = V.by_error(_ONE - along, X_w)
    for i in range(k):
        A[i, :, start + 3 * i : start + 3 * i + 3] = across[i]
    noise = u * np.square(sigma)[:, None, None] * u.transpose(0, 2, 1)
    V = augment(V, X, V.error_columns(walls), A, noise)
    new = Features(
        uid=area.next_uid + np.arange(k),
        kind=np.array([END] * k),
        wall=area.features.uid[walls],
        side=sides,
        lo=np.zeros(k),
        hi=np.zeros(k),
        seen=np.array([1] * k),
        last=np.array([key] * k),
    )
    return AreaMap(V, joined(area.features, new), area.next_uid + k, area.glimpsed)


def forget(area: AreaMap, drop: NDArray[np.bool_]) -> AreaMap:
    """The area without the objects where `drop` (n,) is True: what is left is marginal."""
    keep = np.flatnonzero(~drop)
    return area._replace(
        V=remove_objects(area.V, keep + 1),
        features=Features._make(column[keep] for column in area.features),
    )


def joined(old: Features, new: Features) -> Features:
    """The features of `old`, then those of `new`."""
    return Features._make(map(np.concatenate, zip(old, new, strict=True)))


def area_from_here(area: AreaMap, key: int) -> AreaMap:
    """A new area about the robot, which is certain in its frame.

    It begins with the walls and ends that were seen in key scan `key`, as the old area knows
    them relative to the robot.

    Without them a step of odometry between the last scan of one area and the first of the next
    would be believed unchecked. What their errors have in common with the old area's anchor is
    neglected: it is the noise of a few scans against the drift of all the way there.
    """
    f = area.features
    keep = np.flatnonzero((f.last == key) & (f.kind != ANCHOR))
    keep = keep[(f.kind[keep] == WALL) | np.isin(f.wall[keep], f.uid[keep])]
    kept = Features._make(column[keep] for column in f)
    return AreaMap(seen_from_robot(area.V, keep + 1), kept, area.next_uid)
