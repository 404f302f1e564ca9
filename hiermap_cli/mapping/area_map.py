"""The stochastic map of an area: the robot, and the walls and wall ends seen from it.

Every object is a pose R_a_l (section 5.2). A *wall* has its X axis along the line, the free side
on its left, and binds y and theta; its x is a convention. An *end* lies on a wall where that
wall begins or ends, and binds x, y and theta, of which y and theta are its wall's: it is born
with them, and only its x is measured. So each segment of a scan enters once, through its wall,
and each end once; nothing is counted twice. Corners, doors and corridors are groups of these
(see `landmarks`): two landmarks that share a wall are correlated through it, exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.motion import LASER_X, PARAMETERS
from hiermap_cli.estimation.stochastic_map import (
    Rows,
    StochasticMap,
    add_objects,
    augment,
    remove_objects,
    seen_from_robot,
)
from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

WALL, END, ANCHOR = 0, 1, 2


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


NO_GLIMPSES = np.zeros((0, 4))


@dataclass(frozen=True, slots=True)
class AreaMap:
    """V and C(V) of one area and its features; `next_uid` is the next free uid.

    glimpsed: (g, 4) ends seen once, which are not in V yet: uid of the wall, side, x along the
    wall, key scan. Most ends that are seen once are seen never again.
    """

    V: StochasticMap
    features: Features
    next_uid: int = 0
    glimpsed: Array = field(default_factory=lambda: NO_GLIMPSES)


class Frames(NamedTuple):
    """Objects' frames as the scan sees them, R_s_l of n objects.

    table: (5, n), the rows x, y, theta, and the cosine and the sine of theta: in one array, so
    that some objects are picked out at one stroke.

    Segments are given with the nominal mount; the laser's x error moves them along the robot's
    X axis, so that s, the pose for measuring, is `R_r (laser_x, 0, 0)`.
    """

    table: Array

    @property
    def x(self) -> Array:
        """X of R_s_l, (n,)."""
        return np.asarray(self.table[0])

    @property
    def y(self) -> Array:
        """Y of R_s_l, (n,)."""
        return np.asarray(self.table[1])

    @property
    def theta(self) -> Array:
        """Heading of R_s_l, (n,), not wrapped."""
        return np.asarray(self.table[2])

    @property
    def cos(self) -> Array:
        """Cosine of the heading, (n,)."""
        return np.asarray(self.table[3])

    @property
    def sin(self) -> Array:
        """Sine of the heading, (n,)."""
        return np.asarray(self.table[4])

    def select(self, objects: Index) -> Frames:
        """The frames of some objects."""
        return Frames(self.table[:, objects])


def seen_frames(V: StochasticMap, objects: Index | None = None) -> Frames:
    """The frames of all objects, or of those given (indices from 0), seen from the scan."""
    poses = V.poses[1:] if objects is None else V.poses[1 + objects]
    x_s, y_s, theta_s = measuring_pose(V).tolist()
    c, s = math.cos(theta_s), math.sin(theta_s)
    dx, dy = poses[:, 0] - x_s, poses[:, 1] - y_s
    table = np.empty((5, len(poses)))
    table[0] = c * dx + s * dy
    table[1] = c * dy - s * dx
    theta = table[2] = poses[:, 2] - theta_s
    np.cos(theta, out=table[3])
    np.sin(theta, out=table[4])
    return Frames(table)


def measuring_pose(V: StochasticMap) -> Array:
    """The robot's pose moved by the estimated error of the laser's x, (3,)."""
    if len(V.parameters) != PARAMETERS:
        return V.robot
    x, y, theta = V.robot.tolist()
    shift = float(V.parameters[LASER_X])
    return np.array([x + math.cos(theta) * shift, y + math.sin(theta) * shift, theta])


class Matches(NamedTuple):
    """Segments and ends of a scan matched to objects.

    segment: (a,), wall: (a,) object index of each. end_segment, end_side: (b,) which end of
    which segment, end: (b,) its object index. Object indices count from 0.
    """

    segment: Index
    wall: Index
    end_segment: Index
    end_side: Index
    end: Index

    def empty(self) -> bool:
        """Whether nothing was matched."""
        return not len(self.wall) and not len(self.end)


def innovations(frames: Frames, view: SegmentView, matches: Matches) -> Array:
    """Of matched segments (y, theta at the wall's origin), then of ends (x), (2 a + b,).

    `frames` are those of the matched walls, then of the matched ends, (a + b).
    """
    a = len(matches.wall)
    point = np.concatenate(
        (view.centre[matches.segment], view.ends[matches.end_segment, matches.end_side])
    )
    dx, dy = point[:, 0] - frames.x, point[:, 1] - frames.y
    x, y = frames.cos * dx + frames.sin * dy, frames.cos * dy - frames.sin * dx
    dtheta = se2.wrap(view.theta[matches.segment] - frames.theta[:a])
    out = np.empty(2 * a + len(matches.end))
    out[0 : 2 * a : 2] = y[:a] - np.tan(dtheta) * x[:a]
    out[1 : 2 * a : 2] = dtheta
    out[2 * a :] = x[a:]
    return out


def match_rows(V: StochasticMap, frames: Frames, view: SegmentView, matches: Matches) -> Rows:
    """The rows of matched segments and ends.

    Where each is measured minus where it is predicted, in the wall's or end's own frame. It
    shrinks with the robot's error, grows with the object's.
    """
    a, b = len(matches.wall), len(matches.end)
    objects = np.concatenate((matches.wall, matches.end))
    x, y, theta = V.poses[1 + objects].T
    c, s = np.cos(theta), np.sin(theta)
    # Rows of Ad(X_l^-1).
    H = np.zeros((2 * a + b, 3))
    rows_y, rows_theta, rows_x = slice(0, 2 * a, 2), slice(1, 2 * a, 2), slice(2 * a, None)
    H[rows_y, 0], H[rows_y, 1] = -s[:a], c[:a]
    H[rows_y, 2] = c[:a] * x[:a] + s[:a] * y[:a]
    H[rows_theta, 2] = 1.0
    H[rows_x, 0], H[rows_x, 1] = c[a:], s[a:]
    H[rows_x, 2] = s[a:] * x[a:] - c[a:] * y[a:]
    H_parameters = np.zeros((2 * a + b, len(V.parameters)))
    if len(V.parameters) == PARAMETERS:
        H_parameters[rows_y, LASER_X] = frames.sin[:a]
        H_parameters[rows_x, LASER_X] = -frames.cos[a:]
    pose = np.concatenate((np.repeat(matches.wall, 2), matches.end)) + 1
    return Rows(innovations(frames, view, matches), pose, H, H_parameters)


def match_noise(frames: Frames, view: SegmentView, matches: Matches) -> Array:
    """R (k, k) of `match_rows`.

    A segment's line noise carried from its centre to the wall's origin by the lever arm between
    them.
    """
    a, b = len(matches.wall), len(matches.end)
    R = np.zeros((2 * a + b, 2 * a + b))
    i = 2 * np.arange(a)
    R_yy, R_yt, R_tt = wall_noise(
        frames.select(np.arange(a)) if b else frames, view, matches.segment
    )
    R[i, i] = R_yy
    R[i, i + 1] = R[i + 1, i] = R_yt
    R[i + 1, i + 1] = R_tt
    j = 2 * a + np.arange(b)
    R[j, j] = view.end_sigma[matches.end_segment, matches.end_side] ** 2
    return R


def wall_noise(frames: Frames, view: SegmentView, segment: Index) -> tuple[Array, Array, Array]:
    """Variances and covariance (c,) of (y, theta) of segments at the origins of their walls."""
    centre = view.centre[segment]
    x = frames.cos * (centre[:, 0] - frames.x) + frames.sin * (centre[:, 1] - frames.y)
    var_theta = view.var_theta[segment]
    return view.var_y[segment] + x**2 * var_theta, -x * var_theta, var_theta


def add_walls(area: AreaMap, view: SegmentView, segments: Index, key: int) -> AreaMap:
    """New walls (equation 2), each with its frame at the segment's centre."""
    if not len(segments):
        return area
    V = area.V
    k = len(segments)
    shift = V.parameters[LASER_X] if len(V.parameters) == PARAMETERS else 0.0
    R_r_l = np.column_stack((view.centre[segments], view.theta[segments]))
    R_r_l[:, 0] += shift
    half = 0.5 * view.length[segments]
    C = np.zeros((k, 3, 3))
    C[:, 0, 0] = np.maximum(half, 0.5) ** 2
    C[:, 1, 1], C[:, 2, 2] = view.var_y[segments], view.var_theta[segments]
    by_parameters = np.zeros((k, 3, len(V.parameters)))
    if len(V.parameters) == PARAMETERS:
        theta = view.theta[segments]
        by_parameters[:, 0, LASER_X], by_parameters[:, 1, LASER_X] = np.cos(theta), -np.sin(theta)
    V = add_objects(V, R_r_l, C, by_parameters)
    along = np.einsum(
        "sei,si->se",
        view.ends[segments] - view.centre[segments][:, None],
        np.column_stack((np.cos(view.theta[segments]), np.sin(view.theta[segments]))),
    )
    new = Features(
        uid=area.next_uid + np.arange(k),
        kind=np.full(k, WALL),
        wall=np.full(k, -1),
        side=np.zeros(k, dtype=np.int64),
        lo=along[:, 0],
        hi=along[:, 1],
        seen=np.ones(k, dtype=np.int64),
        last=np.full(k, key),
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
    k, N, m = len(walls), len(V.covariance), len(V.parameters)
    X_w = V.poses[1 + walls]
    X = se2.compose(X_w, np.column_stack((x, np.zeros(k), np.zeros(k))))
    Ad, Ad_inverse = se2.adjoint(X), se2.adjoint(se2.invert(X))
    of_wall, of_robot = Ad_inverse.copy(), np.zeros((k, 3, 3))
    of_wall[:, 0] = 0.0
    of_robot[:, 0] = Ad_inverse[:, 0]
    A = np.zeros((k, 3, N))
    A[:, :, :3] = Ad @ of_robot @ V.invariant_D_error(V.robot)
    for i, w in enumerate(walls):
        A[i, :, V.columns(int(w) + 1)] = Ad[i] @ of_wall[i] @ V.invariant_D_error(X_w[i])
    if m == PARAMETERS:
        A[:, :, 3 + LASER_X] = Ad[:, :, 0] * np.cos(X[:, 2] - V.robot[2])[:, None]
    noise = Ad[:, :, :1] @ Ad[:, :, :1].transpose(0, 2, 1) * np.square(sigma)[:, None, None]
    V = augment(V, X, A.reshape(3 * k, N), noise)
    new = Features(
        uid=area.next_uid + np.arange(k),
        kind=np.full(k, END),
        wall=area.features.uid[walls],
        side=sides,
        lo=np.zeros(k),
        hi=np.zeros(k),
        seen=np.ones(k, dtype=np.int64),
        last=np.full(k, key),
    )
    return AreaMap(V, joined(area.features, new), area.next_uid + k, area.glimpsed)


def forget(area: AreaMap, drop: NDArray[np.bool_]) -> AreaMap:
    """The area without the objects where `drop` (n,) is True: what is left is marginal."""
    keep = np.flatnonzero(~drop)
    return replace(
        area,
        V=remove_objects(area.V, keep + 1),
        features=Features._make(column[keep] for column in area.features),
    )


def joined(old: Features, new: Features) -> Features:
    """The features of `old`, then those of `new`."""
    return Features._make(np.concatenate(pair) for pair in zip(old, new, strict=True))


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
