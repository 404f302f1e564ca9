"""Landmark segments of a model against the walls and furniture of a reference (`wall_*`)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.measures import measured, ratio, rms
from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.evaluation.placed import PlacedModel

    Array = NDArray[np.float64]

_CHUNK = 500_000  # pairs of point and segment worked on at once
WALL_RADIUS = 0.5  # metres; an end point farther from every wall is an outlier


class WallMetrics(NamedTuple):
    """End points of landmark segments against walls and furniture.

    distances: (s, 2) metres of both ends of every segment of the model.
    """

    rmse: float
    outliers: float
    ends: int
    near: int
    distances: Array

    def metrics(self) -> tuple[Metric, ...]:
        """The figures under the names of eval.json, those that could be measured."""
        return measured(
            Metric("wall_rmse", "m", self.rmse, self.near),
            Metric("wall_outliers", "1", self.outliers, self.ends),
        )


def wall_metrics(model: PlacedModel, reference: ReferenceMap) -> WallMetrics | None:
    """Distance of segment ends to the nearest wall or furniture; None where there is neither."""
    solid = solid_segments(reference)
    if len(solid) == 0:
        return None
    distance = segment_distances(model.segments.reshape(-1, 2), solid)
    near = distance <= WALL_RADIUS
    return WallMetrics(
        rmse=rms(distance[near]),
        outliers=ratio(int((~near).sum()), len(distance)),
        ends=len(distance),
        near=int(near.sum()),
        distances=distance.reshape(-1, 2),
    )


def solid_segments(reference: ReferenceMap) -> Array:
    """Everything of the reference that blocks the view, (W + F, 4)."""
    parts = [part for part in (reference.walls, reference.furniture) if part is not None]
    return np.concatenate(parts) if parts else np.zeros((0, 4))


def segment_distances(points: Array, segments: Array) -> Array:
    """Distance (n,) of points (n, 2) to the nearest of the segments (W, 4)."""
    start, span = segments[:, :2], segments[:, 2:] - segments[:, :2]
    squared = np.maximum((span**2).sum(axis=1), 1e-18)
    nearest = np.full(len(points), math.inf)
    chunk = max(1, _CHUNK // max(len(segments), 1))
    for begin in range(0, len(points), chunk):
        x, y = (points[begin : begin + chunk, None] - start).transpose(2, 0, 1)
        along = np.clip((x * span[:, 0] + y * span[:, 1]) / squared, 0.0, 1.0)
        away = (x - along * span[:, 0]) ** 2 + (y - along * span[:, 1]) ** 2
        nearest[begin : begin + chunk] = np.sqrt(away.min(axis=1, initial=math.inf))
    return nearest
