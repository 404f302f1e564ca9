"""Areas of a model against those of a reference, and how they hang together.

`area_*` after Bormann et al. 2016, "Room segmentation: survey, implementation, and analysis",
and `topology_*`. Overlaps are exact areas of polygons.

**The part of a reference area that was seen** is what the robot saw of it from inside: the union
of the stars of sight from every pose of the trajectory in the area, blocked by the area's own
outline and by the reference's walls and furniture. It does not depend on the model, so that a
room which the model lost counts as lost. A visited area without a pose in it was not seen, and is
left out of the recall.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hiermap_cli.evaluation.matching import match_largest
from hiermap_cli.evaluation.measures import measured, ratio
from hiermap_cli.evaluation.visibility import ALL_AROUND, View, spread, star, viewpoints
from hiermap_cli.evaluation.walls import solid_segments
from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hiermap_cli.documents.reference import ReferenceArea, ReferenceMap
    from hiermap_cli.evaluation.placed import PlacedModel

    Array = NDArray[np.float64]

_CRUMB = 1e-4  # square metres that no longer count as unseen


class AreaMatch(NamedTuple):
    """A model area and the reference area that it is, with their intersection over union."""

    model: str
    reference: str
    iou: float


class AreaShare(NamedTuple):
    """An area, the area of the other map that overlaps it most, and that share of it.

    `other` is None where nothing overlaps it; `share` is None where nothing of it was seen.
    """

    area: str
    other: str | None
    share: float | None


class AreaMetrics(NamedTuple):
    """Means over areas; nan where there is nothing to divide by.

    recalled: of every visited reference area, of what was seen of it; covered: of every area of
    the model. `matches` are one to one with IoU >= 0.5; `found` areas of the model have an extent,
    `asked` reference areas were visited, `seen` of them also from inside.
    """

    precision: float
    recall: float
    f1_iou50: float
    found: int
    asked: int
    seen: int
    matches: tuple[AreaMatch, ...]
    recalled: tuple[AreaShare, ...]
    covered: tuple[AreaShare, ...]

    def metrics(self) -> tuple[Metric, ...]:
        """The figures under the names of eval.json, those that could be measured."""
        return measured(
            Metric("area_precision", "1", self.precision, self.found),
            Metric("area_recall", "1", self.recall, self.seen),
            Metric("area_f1_iou50", "1", self.f1_iou50, self.found + self.asked),
        )


class TopologyMetrics(NamedTuple):
    """Edges of the area graph; nan where there is nothing to divide by.

    same: what reference area each of the model's is. right, false: edges of the model by its own
    names; missed: edges of the reference.
    """

    precision: float
    recall: float
    found: int
    asked: int
    same: dict[str, str]
    right: tuple[tuple[str, ...], ...]
    false: tuple[tuple[str, ...], ...]
    missed: tuple[tuple[str, ...], ...]

    def metrics(self) -> tuple[Metric, ...]:
        """The figures under the names of eval.json, those that could be measured."""
        return measured(
            Metric("topology_precision", "1", self.precision, self.found),
            Metric("topology_recall", "1", self.recall, self.asked),
        )


def area_metrics(
    model: PlacedModel,
    reference: ReferenceMap,
    poses: Array,
    view: View = ALL_AROUND,
) -> AreaMetrics | None:
    """Areas of the model against visited ones of the reference; None without areas in it.

    Args:
        model: in the reference's frame.
        reference: its walls and furniture block the view.
        poses: (N, 3) of the robot in the reference's frame, the truth where it is known.
        view: what the laser could see from a pose.
    """
    if reference.areas is None:
        return None
    found = {area.id: shape(area.polygon) for area in model.areas}
    found = {area: polygon for area, polygon in found.items() if polygon.area > 0}
    true = [shape(area.polygon) for area in reference.areas]
    visited = [area for area in reference.areas if area.visited]
    asked = [shape(area.polygon) for area in visited]
    seen = [seen_part(area, reference, poses, view) for area in visited]
    recalled = _shares(
        [area.id for area in visited], seen, list(found), _overlaps(seen, found.values())
    )
    recalls = [one.share for one in recalled if one.share is not None]
    overlap = _overlaps(found.values(), true)
    covered = _shares(list(found), found.values(), [area.id for area in reference.areas], overlap)
    precisions = [one.share for one in covered if one.share is not None]
    iou = _ious(found.values(), asked)
    pairs = match_largest(iou, iou >= 0.5)
    ids = tuple(found)
    return AreaMetrics(
        precision=float(np.mean(precisions)) if precisions else math.nan,
        recall=float(np.mean(recalls)) if recalls else math.nan,
        f1_iou50=ratio(2 * len(pairs), len(found) + len(asked)),
        found=len(found),
        asked=len(asked),
        seen=len(recalls),
        matches=tuple(AreaMatch(ids[i], visited[j].id, float(iou[i, j])) for i, j in pairs),
        recalled=recalled,
        covered=covered,
    )


def topology_metrics(model: PlacedModel, reference: ReferenceMap) -> TopologyMetrics | None:
    """Pairs of areas joined by a crossed door; None without areas or doors in the reference.

    Areas are matched one to one by largest overlap, of at least half of the smaller one; an edge
    of the model with an area that has no match is wrong.
    """
    if reference.areas is None or reference.doors is None:
        return None
    found = [shape(area.polygon) for area in model.areas]
    true = [shape(area.polygon) for area in reference.areas]
    overlap = _overlaps(found, true)
    smaller = np.minimum.outer([p.area for p in found], [p.area for p in true])
    pairs = match_largest(
        overlap, (overlap > 0) & (overlap >= 0.5 * smaller.reshape(overlap.shape))
    )
    name = {model.areas[i].id: reference.areas[j].id for i, j in pairs}
    edges = _edges(door.areas for door in model.doors if door.crossed)
    asked = _edges(door.areas for door in reference.doors if door.visited)
    meant = {edge: frozenset(name.get(area, "") for area in edge) for edge in edges}
    right = set(meant.values()) & asked
    return TopologyMetrics(
        precision=ratio(len(right), len(edges)),
        recall=ratio(len(right), len(asked)),
        found=len(edges),
        asked=len(asked),
        same=name,
        right=_listed(edge for edge, is_ in meant.items() if is_ in asked),
        false=_listed(edge for edge, is_ in meant.items() if is_ not in asked),
        missed=_listed(asked - right),
    )


def _listed(edges: Iterable[frozenset[str]]) -> tuple[tuple[str, ...], ...]:
    """Edges with their areas, all in the order of names."""
    return tuple(sorted(tuple(sorted(edge)) for edge in edges))


def seen_part(area: ReferenceArea, reference: ReferenceMap, poses: Array, view: View) -> Any:
    """The part of a reference area that the robot saw from inside it, as a shapely geometry.

    Poses (N, 3) are in the reference's frame.
    """
    import shapely

    polygon = shape(area.polygon)
    xmin, ymin, xmax, ymax = polygon.bounds
    outline = np.hstack((area.polygon, np.roll(area.polygon, -1, axis=0)))
    solid = solid_segments(reference)
    low, high = np.minimum(solid[:, :2], solid[:, 2:]), np.maximum(solid[:, :2], solid[:, 2:])
    near = ((low <= (xmax, ymax)) & (high >= (xmin, ymin))).all(axis=1)
    blockers = np.concatenate((outline, solid[near]))
    inside = shapely.contains_xy(polygon, poses[:, 0], poses[:, 1])
    # Beyond the diagonal there is nothing of the area: rays end there at the latest.
    reach = min(view.reach, 1.0 + float(np.hypot(xmax - xmin, ymax - ymin)))
    unseen = polygon
    # What is left shrinks fast: taking stars away costs far less than joining them.
    for pose in np.concatenate(spread(viewpoints(poses[inside]), 12) or [poses[:0]]):
        left = unseen.difference(shape(star(pose, blockers, View(reach, view.field_of_view))))
        parts = shapely.get_parts(left)
        unseen = shapely.multipolygons(parts[shapely.area(parts) > _CRUMB])
        if unseen.area <= _CRUMB:
            break
    return polygon.difference(unseen)


def shape(polygon: Array) -> Any:
    """A polygon (m, 2) as a valid shapely geometry; nothing of fewer than three points."""
    import shapely

    if len(polygon) < 3:
        return shapely.Polygon()
    return shapely.make_valid(shapely.Polygon(polygon))


def _shares(
    ids: list[str], parts: Iterable[Any], others: list[str], overlap: Array
) -> tuple[AreaShare, ...]:
    """Of each part the largest overlap (n, m) with one of the others, as a share of it."""
    shares = []
    for id_, part, row in zip(ids, parts, overlap, strict=True):
        best = int(np.argmax(row)) if row.size and row.max() > 0 else None
        share = (float(row.max(initial=0.0)) / part.area) if part.area > 0 else None
        shares.append(AreaShare(id_, None if best is None else others[best], share))
    return tuple(shares)


def _overlaps(first: Iterable[Any], second: Iterable[Any]) -> Array:
    """Areas of intersection, shape (n, m)."""
    import shapely

    rows, columns = list(first), list(second)
    overlap = np.zeros((len(rows), len(columns)))
    if rows and columns:
        i, j = shapely.STRtree(columns).query(rows)  # those whose boxes meet
        meet = shapely.intersection(np.array(rows, dtype=object)[i], np.array(columns)[j])
        overlap[i, j] = shapely.area(meet)
    return overlap


def _ious(first: Iterable[Any], second: Iterable[Any]) -> Array:
    """Intersection over union, shape (n, m)."""
    rows, columns = list(first), list(second)
    overlap = _overlaps(rows, columns)
    sizes = np.add.outer([p.area for p in rows], [p.area for p in columns])
    return overlap / (sizes.reshape(overlap.shape) - overlap)


def _edges(joined: Iterable[tuple[str, str]]) -> set[frozenset[str]]:
    """Unordered pairs of two different areas."""
    return {frozenset(pair) for pair in joined if pair[0] != pair[1]}
