"""Corners of a model against those of a reference map (`corner_*`)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.matching import match_points
from hiermap_cli.evaluation.measures import Detections
from hiermap_cli.evaluation.visibility import ALL_AROUND, View, in_view, is_clear
from hiermap_cli.evaluation.walls import segment_distances, solid_segments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.evaluation.placed import PlacedModel
    from hiermap_cli.mapping.model import Metric

    Array = NDArray[np.float64]

CORNER_RADIUS = 0.25  # metres between a corner found and the true one
_JOINED = 0.01  # metres between wall ends that are one point
_PARALLEL = math.radians(5.0)  # walls that differ by less make no corner
_ABOUT = 5.0  # metres about a corner, in which most of what hides it stands
_ALONG = 0.1  # metres along each wall that must be seen for its corner to be seen


class ReferenceCorners(NamedTuple):
    """Points (c, 2) where two walls end together, and a point on each wall beside it (c, 2, 2)."""

    points: Array
    sides: Array

    def select(self, chosen: NDArray[np.bool_]) -> ReferenceCorners:
        """The corners where `chosen` (c,) is True."""
        return ReferenceCorners(self.points[chosen], self.sides[chosen])


def end_corners(segments: Array) -> ReferenceCorners:
    """Points where exactly two of the segments (W, 4) that are not parallel end together."""
    ends = segments.reshape(-1, 2)
    inward = segments.reshape(-1, 2, 2)[:, ::-1].reshape(-1, 2) - ends
    length = np.hypot(inward[:, 0], inward[:, 1])
    points, sides = [], []
    for group in _joined(ends):
        if len(group) != 2:
            continue
        direction = inward[group] / length[group, None]
        cross = direction[0, 0] * direction[1, 1] - direction[0, 1] * direction[1, 0]
        if abs(cross) < math.sin(_PARALLEL):
            continue
        points.append(ends[group].mean(axis=0))
        sides.append(ends[group] + np.minimum(_ALONG, 0.5 * length[group])[:, None] * direction)
    return ReferenceCorners(np.array(points).reshape(-1, 2), np.array(sides).reshape(-1, 2, 2))


def _joined(ends: Array) -> list[list[int]]:
    """Groups of points (n, 2) that are chained by gaps of at most `_JOINED`, by first index."""
    order = np.argsort(ends[:, 0], kind="stable")
    parent = list(range(len(ends)))

    def root(i: int) -> int:
        while parent[i] != i:
            i = parent[i]
        return i

    for offset in range(1, len(ends)):
        a, b = order[:-offset], order[offset:]
        close_x = ends[b, 0] - ends[a, 0] <= _JOINED
        if not close_x.any():
            break
        close = close_x & (np.hypot(*(ends[b] - ends[a]).T) <= _JOINED)
        for i, j in zip(a[close].tolist(), b[close].tolist(), strict=True):
            first, second = sorted((root(i), root(j)))
            parent[second] = first
    groups: dict[int, list[int]] = {}
    for i in range(len(ends)):
        groups.setdefault(root(i), []).append(i)
    return list(groups.values())


def furniture_corners(reference: ReferenceMap) -> Array:
    """Corners (c, 2) that furniture makes: of its own sides, and where a side ends on a wall."""
    furniture = reference.furniture
    if furniture is None or len(furniture) == 0:
        return np.zeros((0, 2))
    own = end_corners(furniture).points
    if reference.walls is None or len(reference.walls) == 0:
        return own
    ends = furniture.reshape(-1, 2)
    ends = np.array([ends[group].mean(axis=0) for group in _joined(ends)])
    on_wall = segment_distances(ends, reference.walls) <= _JOINED
    if len(own):
        apart = np.hypot(*np.moveaxis(ends[:, None] - own[None], -1, 0))
        on_wall &= apart.min(axis=1) > _JOINED
    return np.concatenate((own, ends[on_wall]))


def wall_corners(reference: ReferenceMap) -> ReferenceCorners:
    """The corners of the reference's walls."""
    walls = reference.walls
    return end_corners(walls if walls is not None else np.zeros((0, 4)))


class CornerMetrics(NamedTuple):
    """Corners of the model against those of the reference.

    pairs: (matched, 2) of a corner of the model with a true one. true: (m, 2) corners of walls,
    then of furniture. missed: indices of those that were asked for and not found.
    """

    detections: Detections
    pairs: NDArray[np.int64]
    true: Array
    missed: tuple[int, ...]

    def metrics(self) -> tuple[Metric, ...]:
        """The figures under the names of eval.json, those that could be measured."""
        return self.detections.metrics("corner")


def corner_metrics(
    model: PlacedModel,
    reference: ReferenceMap,
    views: Array,
    view: View = ALL_AROUND,
) -> CornerMetrics | None:
    """Corners of the model against those of the reference; None without walls in it.

    Asked for are wall corners whose nearest area, within 0.25 m, was visited (all where the
    reference has no areas) and of which a pose in `views` (V, 3), in the reference's frame,
    sees the vertex and a stretch of both walls. Corners of furniture are right when found, and
    not asked for.
    """
    if reference.walls is None:
        return None
    walls = wall_corners(reference)
    true = np.concatenate((walls.points, furniture_corners(reference)))
    pairs = match_points(model.corners.points, true, CORNER_RADIUS)
    asked = _in_visited(walls.points, reference)
    asked[asked] = _seen(walls.select(asked), reference, views, view)
    recalled = asked[pairs[pairs[:, 1] < len(asked), 1]]
    missed = np.setdiff1d(np.flatnonzero(asked), pairs[:, 1])
    error = model.corners.points[pairs[:, 0]] - true[pairs[:, 1]]
    return CornerMetrics(
        Detections(
            found=len(model.corners.points),
            asked=int(asked.sum()),
            recalled=int(recalled.sum()),
            errors=np.hypot(error[:, 0], error[:, 1]),
        ),
        pairs=pairs,
        true=true,
        missed=tuple(missed.tolist()),
    )


def _seen(
    corners: ReferenceCorners, reference: ReferenceMap, views: Array, view: View
) -> NDArray[np.bool_]:
    """Which corners (c,) are in sight with both their walls from one of the poses.

    The nearest poses are asked first: from one of them most corners are seen that are seen at all.
    """
    obstacles = solid_segments(reference)
    low = np.minimum(obstacles[:, :2], obstacles[:, 2:])
    high = np.maximum(obstacles[:, :2], obstacles[:, 2:])
    seen = np.zeros(len(corners.points), dtype=bool)
    for c, (point, sides) in enumerate(zip(corners.points, corners.sides, strict=True)):
        targets = np.concatenate((point[None], sides))
        apart = (views[:, 0] - point[0]) ** 2 + (views[:, 1] - point[1]) ** 2
        near = views[np.argpartition(apart, min(2, len(views) - 1))] if len(views) else views
        # What hides a corner stands about it as a rule: few lines are left for the rest, and none
        # that begin there too.
        about = obstacles[((low <= point + _ABOUT) & (high >= point - _ABOUT)).all(axis=1)]
        begin, size = 0, 2
        while begin < len(near) and not seen[c]:
            batch = near[begin : begin + size]
            batch = batch[in_view(batch, targets, view).all(axis=1)]
            for target in targets:
                batch = batch[is_clear(batch[:, :2], target, about)]
            afar = (np.abs(batch[:, :2] - point) > _ABOUT - _ALONG).any(axis=1)
            if len(batch) and afar.all():
                for target in targets:
                    batch = batch[is_clear(batch[:, :2], target, obstacles)]
            seen[c] = len(batch) > 0
            if begin == 0 and not seen[c]:
                near = views[np.argsort(apart, kind="stable")]
            begin, size = begin + size, 4 * size
    return seen


def _in_visited(points: Array, reference: ReferenceMap) -> NDArray[np.bool_]:
    """Which points (n,) belong to a visited area: the nearest one, within 0.25 m."""
    if not reference.areas:
        return np.full(len(points), reference.areas is None)
    import shapely  # only map metrics need it

    outlines = [shapely.make_valid(shapely.Polygon(area.polygon)) for area in reference.areas]
    distance = shapely.distance(np.array(outlines)[:, None], shapely.points(points)[None, :])
    # Where a wall is a mere line, its corners belong to the areas on both sides.
    belongs = (distance <= distance.min(axis=0) + _JOINED) & (distance <= CORNER_RADIUS)
    visited = np.array([area.visited for area in reference.areas])
    return np.asarray((belongs & visited[:, None]).any(axis=0), dtype=np.bool_)
