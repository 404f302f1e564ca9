"""Plane geometry of floor plans: polygons as corner arrays (n, 2), segments as (..., 4).

A segment is `[x1, y1, x2, y2]` in metres; polygons are not closed (the last corner is joined to
the first) and, where it matters, counterclockwise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

TINY = 1e-9  # metres; nearer than this, two points of a plan are one


def signed_area(corners: Array) -> float:
    """Area in square metres, positive where the corners run counterclockwise."""
    x, y = (corners - corners[0]).T
    return 0.5 * float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


def counterclockwise(corners: Array) -> Array:
    """The same polygon, counterclockwise, from the same first corner."""
    if signed_area(corners) < 0.0:
        corners = np.roll(corners[::-1], 1, axis=0)
    return corners


def edges(corners: Array) -> Array:
    """The polygon's edges as segments (n, 4), in order."""
    return np.hstack((corners, np.roll(corners, -1, axis=0)))


def drawn_in(corners: Array, distance: float) -> Array:
    """Every edge of a counterclockwise polygon moved inwards; outwards if `distance` < 0.

    Corners are mitred. A corner between two edges of one line is moved along their normal.
    """
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    n_out = np.column_stack((-along[:, 1], along[:, 0]))  # left of the edge is inside
    n_in = np.roll(n_out, 1, axis=0)
    # The mitre m has m . n_in = m . n_out = 1.
    mitre = (n_in + n_out) / (1.0 + np.sum(n_in * n_out, axis=1))[:, None]
    moved: Array = corners + distance * mitre
    return moved


def contains(corners: Array, points: Array) -> NDArray[np.bool_]:
    """Whether points (m, 2) lie inside, by the even-odd rule; on the edge either may come out."""
    x, y = points[:, 0], points[:, 1]
    low, high = corners.min(axis=0), corners.max(axis=0)
    inside: NDArray[np.bool_] = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    where = np.flatnonzero(inside)
    if not len(where):
        return inside
    x, y = x[where, None], y[where, None]
    x1, y1, x2, y2 = edges(corners).T
    crosses = (y1 > y) != (y2 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        left_of = x < x1 + (y - y1) / (y2 - y1) * (x2 - x1)
    inside[where] = np.sum(crosses & left_of, axis=1) % 2 == 1
    return inside


def crossings(segments_a: Array, segments_b: Array) -> Array:
    """Where each of (A, 4) is met by each of (B, 4): fractions along a, (A, B), nan if not.

    Touching counts; segments of one line are left to their end points and give nan.
    """
    p, r = segments_a[:, None, :2], segments_a[:, None, 2:] - segments_a[:, None, :2]
    q, s = segments_b[None, :, :2], segments_b[None, :, 2:] - segments_b[None, :, :2]
    length_r, length_s = np.hypot(r[..., 0], r[..., 1]), np.hypot(s[..., 0], s[..., 1])
    denominator = _cross(r, s)
    with np.errstate(divide="ignore", invalid="ignore"):
        t, u = _cross(q - p, s) / denominator, _cross(q - p, r) / denominator
        near_t, near_u = TINY / length_r, TINY / length_s
        meet = (t >= -near_t) & (t <= 1.0 + near_t) & (u >= -near_u) & (u <= 1.0 + near_u)
        meet &= np.abs(denominator) > TINY * length_r * length_s
    return np.where(meet, t, np.nan)


def is_simple(corners: Array) -> bool:
    """Whether no two edges meet but neighbours at their common corner."""
    n = len(corners)
    sides = edges(corners)
    lengths = np.hypot(*(sides[:, 2:] - sides[:, :2]).T)
    if (lengths < TINY).any():
        return False
    index = np.arange(n)
    apart = (index[:, None] - index[None, :]) % n
    others = (apart > 1) & (apart < n - 1)
    if (np.isfinite(crossings(sides, sides)) & others).any():
        return False
    # A corner on another edge covers what crossings leave out: edges that lie on one line.
    on_edge = point_distances(corners, sides) < TINY
    own = (apart == 0) | (apart == 1)  # corner i begins edge i and ends edge i - 1
    if (on_edge & ~own).any():
        return False
    directions = (sides[:, 2:] - sides[:, :2]) / lengths[:, None]
    turned_back = np.sum(directions * np.roll(directions, 1, axis=0), axis=1) < -1.0 + TINY
    return not turned_back.any()


def point_distances(points: Array, segments: Array) -> Array:
    """Distances (m, s) of points (m, 2) from segments (s, 4), metres."""
    a, along = segments[None, :, :2], segments[None, :, 2:] - segments[None, :, :2]
    to_point = points[:, None, :] - a
    length2 = np.maximum(np.sum(along * along, axis=-1), TINY * TINY)
    t = np.clip(np.sum(to_point * along, axis=-1) / length2, 0.0, 1.0)
    off = to_point - t[..., None] * along
    distances: Array = np.hypot(off[..., 0], off[..., 1])
    return distances


def way_clearance(ways: Array, segments: Array) -> Array:
    """Smallest distance (w,) of straight ways (w, 4) from segments (s, 4); 0 where they cross."""
    if not len(segments):
        return np.full(len(ways), np.inf)
    ends = np.minimum(
        point_distances(ways[:, :2], segments).min(axis=1),
        point_distances(ways[:, 2:], segments).min(axis=1),
    )
    corners = np.vstack((segments[:, :2], segments[:, 2:]))
    clearance = np.minimum(ends, point_distances(corners, ways).min(axis=0))
    return np.where(np.isfinite(crossings(ways, segments)).any(axis=1), 0.0, clearance)


def within(segments: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Whether the bounding box of each segment (s, 4) meets the box from `low` to `high`."""
    meets: NDArray[np.bool_] = (
        (np.minimum(segments[:, 0], segments[:, 2]) <= high[0])
        & (np.maximum(segments[:, 0], segments[:, 2]) >= low[0])
        & (np.minimum(segments[:, 1], segments[:, 3]) <= high[1])
        & (np.maximum(segments[:, 1], segments[:, 3]) >= low[1])
    )
    return meets


def _cross(a: Array, b: Array) -> Array:
    """The z component of the cross product."""
    out: Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out
