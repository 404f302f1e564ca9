"""Walls out of all key scans, and which segment of which scan shows which wall.

The filter has matched most segments with walls of the area it was in; its matches begin the
walls. What two areas have both seen, and what was left unmatched, is found by how the segments
lie in g: walls that are nearly one line and overlap are one, and a segment belongs to the wall
on whose line it lies and with which it overlaps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.refinement.problem import Ends, Matched, State, Walls, in_g
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import RefineConfig
    from hiermap_cli.mapping.keyscans import KeyScans, ScanSegments
    from hiermap_cli.mapping.refinement.problem import Noise

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


class Placed(NamedTuple):
    """All S segments in g: centre (S, 2), theta (S,) and ends (S, 2, 2)."""

    centre: Array
    theta: Array
    ends: Array


def placed(state: State, segments: ScanSegments) -> Placed:
    """The segments at the estimated poses."""
    every = np.arange(len(segments.scan))
    theta = se2.wrap(state.poses[segments.scan, 2] + segments.theta)
    ends = [in_g(state, segments, every, segments.ends[:, k]) for k in (0, 1)]
    return Placed(in_g(state, segments, every, segments.centre), theta, np.stack(ends, axis=1))


def filter_labels(keyscans: KeyScans) -> Index:
    """A number for each segment by the wall of the filter that it was matched with, or -1."""
    s = keyscans.segments
    known = s.wall >= 0
    pairs = np.column_stack((keyscans.area[s.scan[known]], s.wall[known]))
    labels = np.full(len(s.scan), -1)
    if len(pairs):
        labels[known] = np.unique(pairs, axis=0, return_inverse=True)[1].ravel()
    return labels


def fit_walls(where: Placed, labels: Index, length: Array, count: int) -> Walls:
    """Lines through the segments of each label (-1: none), weighted by their length."""
    k = np.flatnonzero(labels >= 0)
    w, label = length[k], labels[k]
    total = np.maximum(np.bincount(label, w, count), 1e-12)
    c = np.bincount(label, w * np.cos(where.theta[k]), count)
    s = np.bincount(label, w * np.sin(where.theta[k]), count)
    theta = np.arctan2(s, c)
    x = np.bincount(label, w * where.centre[k, 0], count) / total
    y = np.bincount(label, w * where.centre[k, 1], count) / total
    return with_extents(Walls(np.column_stack((x, y, theta)), x, x), where, labels)


def with_extents(walls: Walls, where: Placed, labels: Index) -> Walls:
    """The walls with the reach of their segments along them."""
    k = np.flatnonzero(labels >= 0)
    W = walls.poses[labels[k]]
    d = where.ends[k] - W[:, None, :2]
    along = np.cos(W[:, 2])[:, None] * d[..., 0] + np.sin(W[:, 2])[:, None] * d[..., 1]
    lo, hi = np.full(len(walls.poses), np.inf), np.full(len(walls.poses), -np.inf)
    np.minimum.at(lo, labels[k], along[:, 0])
    np.maximum.at(hi, labels[k], along[:, 1])
    empty = lo > hi
    lo[empty] = hi[empty] = 0.0
    return walls._replace(lo=lo, hi=hi)


def near_pairs(a: Walls, lines: Array, margin: float) -> tuple[Index, Index]:
    """Lines (n, 2, 2) and walls whose boxes, widened by `margin`, touch: indices of both."""
    import shapely

    def boxes(ends: Array, by: float) -> Array:
        low, high = ends.min(axis=1) - by, ends.max(axis=1) + by
        return np.asarray(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))

    if not len(lines) or not len(a.poses):
        none = np.zeros(0, dtype=np.int64)
        return none, none
    tree = shapely.STRtree(boxes(wall_lines(a), margin))
    i, j = tree.query(boxes(lines, 0.0))
    order = np.lexsort((j, i))
    return np.asarray(i[order]), np.asarray(j[order])


def wall_lines(walls: Walls) -> Array:
    """Both ends of each wall in g, (W, 2, 2)."""
    t = np.column_stack((np.cos(walls.poses[:, 2]), np.sin(walls.poses[:, 2])))
    p = walls.poses[:, :2]
    return np.stack((p + walls.lo[:, None] * t, p + walls.hi[:, None] * t), axis=1)


def match_segments(
    walls: Walls, where: Placed, segments: ScanSegments, scale: float, config: RefineConfig
) -> Index:
    """The wall on which each segment lies, or -1: the nearest line of those that it overlaps."""
    offset, angle = scale * config.match_offset, scale * config.match_angle
    labels = np.full(len(segments.scan), -1)
    use = np.flatnonzero(segments.length >= config.min_length)
    i, j = near_pairs(walls, where.ends[use], offset)
    i = use[i]
    W = walls.poses[j]
    alike = np.cos(where.theta[i] - W[:, 2]) > np.cos(angle)
    i, j, W = i[alike], j[alike], W[alike]
    c, s = np.cos(W[:, 2]), np.sin(W[:, 2])
    d = where.centre[i] - W[:, :2]
    off = np.abs(c * d[:, 1] - s * d[:, 0])
    e = where.ends[i] - W[:, None, :2]
    along = c[:, None] * e[..., 0] + s[:, None] * e[..., 1]
    overlap = np.minimum(along[:, 1], walls.hi[j]) - np.maximum(along[:, 0], walls.lo[j])
    good = (off < offset) & (overlap > config.overlap * segments.length[i])
    i, j, off = i[good], j[good], off[good]
    order = np.lexsort((off, i))
    first = np.unique(i[order], return_index=True)[1]
    labels[i[order][first]] = j[order][first]
    return labels


def merge_walls(walls: Walls, scale: float, config: RefineConfig) -> Index:
    """A number for each wall, the same for walls that are one; `scale` is on what parts them."""
    offset, angle = scale * config.merge_offset, scale * config.merge_angle
    lines = wall_lines(walls)
    i, j = near_pairs(walls, lines, offset)
    i, j = i[i < j], j[i < j]
    long = walls.hi - walls.lo
    swap = long[i] > long[j]
    short, other = np.where(swap, j, i), np.where(swap, i, j)
    W = walls.poses[other]
    c, s = np.cos(W[:, 2]), np.sin(W[:, 2])
    d = lines[short] - W[:, None, :2]
    off = np.abs(c[:, None] * d[..., 1] - s[:, None] * d[..., 0]).max(axis=1)
    along = c[:, None] * d[..., 0] + s[:, None] * d[..., 1]
    overlap = np.minimum(along[:, 1], walls.hi[other]) - np.maximum(along[:, 0], walls.lo[other])
    one = (
        (np.cos(walls.poses[short, 2] - W[:, 2]) > np.cos(angle))
        & (off < offset)
        & (overlap > config.merge_overlap * long[short])
    )
    return components(len(walls.poses), i[one], j[one])


def components(n: int, i: Index, j: Index) -> Index:
    """A number from 0 for each of n nodes, the same for those that edges i - j connect."""
    root = np.arange(n)
    while True:
        least = root.copy()
        np.minimum.at(least, i, root[j])
        np.minimum.at(least, j, root[i])
        least = np.minimum(least, least[least])
        if (least == root).all():
            break
        root = least
    return np.asarray(np.unique(root, return_inverse=True)[1].ravel(), dtype=np.int64)


def match_ends(
    state: State, labels: Index, where: Placed, segments: ScanSegments, noise: Noise,
    config: RefineConfig,
) -> tuple[Ends, Index, Index, Index]:  # fmt: skip
    """Ends of walls where several scans show an end, and which segments' ends they are.

    The places at which a wall was seen to end, sorted along it, are cut where they lie far
    apart; what is left together, and spread as its noise says, is one end. Returns segment, side
    and end too.
    """
    segment, side = np.nonzero((labels >= 0)[:, None] & (segments.end_kind != END_OPEN))
    wall = labels[segment]
    W = state.walls.poses[wall]
    d = where.ends[segment, side] - W[:, :2]
    x = np.cos(W[:, 2]) * d[:, 0] + np.sin(W[:, 2]) * d[:, 1]
    order = np.lexsort((x, side, wall))
    segment, side, wall, x = segment[order], side[order], wall[order], x[order]
    new = np.ones(len(x), dtype=bool)
    new[1:] = (np.diff(wall) != 0) | (np.diff(side) != 0) | (np.diff(x) > config.end_gap)
    cluster = np.cumsum(new) - 1
    n = int(new.sum())
    first = np.flatnonzero(new)
    last = np.append(first[1:], len(x)) - 1 if n else first
    middle = x[(first + last) // 2]
    z2 = np.square(x - middle[cluster]) / noise.ends[segment, side]
    fits = z2 < config.end_outlier
    count = np.bincount(cluster, minlength=n)
    spread = np.bincount(cluster, z2, n) / np.maximum(count, 1)
    good = (count >= config.end_seen) & (spread < config.end_spread)
    number = np.where(good, np.cumsum(good) - 1, -1)[cluster]
    keep = (number >= 0) & fits
    ends = Ends(wall[first][good], side[first][good], middle[good])
    return ends, segment[keep], side[keep], number[keep]


def all_matches(
    state: State, labels: Index, segments: ScanSegments, noise: Noise, config: RefineConfig
) -> tuple[State, Matched]:
    """Walls and ends of these labels, numbered anew where nothing is left of a wall."""
    where = placed(state, segments)
    kept, labels = _renumbered(labels, len(state.walls.poses), config.least_seen)
    walls = Walls._make(column[kept] for column in state.walls)
    state = state._replace(walls=with_extents(walls, where, labels))
    ends, segment, side, end = match_ends(state, labels, where, segments, noise, config)
    matched = np.flatnonzero(labels >= 0)
    order = np.argsort(segment, kind="stable")
    return state._replace(ends=ends), Matched(
        matched, labels[matched], segment[order], side[order], end[order]
    )


def _renumbered(labels: Index, walls: int, least: int) -> tuple[Index, Index]:
    """Walls that at least so many segments show, and the labels with the numbers they get."""
    count = np.bincount(labels[labels >= 0], minlength=walls)
    kept = np.flatnonzero(count >= least)
    number = np.full(walls + 1, -1)
    number[kept] = np.arange(len(kept))
    return kept, number[labels]
