"""Crossed doors of a model against the doors of a reference map (`door_*`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.matching import match_points
from hiermap_cli.evaluation.measures import Detections

if TYPE_CHECKING:
    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.evaluation.placed import PlacedDoor, PlacedModel
    from hiermap_cli.mapping.model import Metric

DOOR_RADIUS = 0.5  # metres between the centres of doors


class DoorMatch(NamedTuple):
    """A door of the model, the reference's door that it is, and metres between their centres."""

    model: str
    reference: str
    error: float


class DoorMetrics(NamedTuple):
    """Crossed doors against visited doors of the reference.

    false: ids of the model's doors without a match; missed: those of the reference.
    """

    detections: Detections
    matches: tuple[DoorMatch, ...]
    false: tuple[str, ...]
    missed: tuple[str, ...]

    def metrics(self) -> tuple[Metric, ...]:
        """The figures under the names of eval.json, those that could be measured."""
        return self.detections.metrics("door")


def door_metrics(model: PlacedModel, reference: ReferenceMap) -> DoorMetrics | None:
    """Crossed doors of the model against visited ones of the reference; None without doors."""
    if reference.doors is None:
        return None
    found: list[PlacedDoor] = [door for door in model.doors if door.crossed]
    centres = np.array([door.centre for door in found]).reshape(-1, 2)
    asked = [door for door in reference.doors if door.visited]
    true = np.array([0.5 * (door.p1 + door.p2) for door in asked])
    pairs = match_points(centres, true.reshape(-1, 2), DOOR_RADIUS)
    error = centres[pairs[:, 0]] - true.reshape(-1, 2)[pairs[:, 1]]
    errors = np.hypot(error[:, 0], error[:, 1])
    matches = tuple(
        DoorMatch(found[i].id, asked[j].id, float(e))
        for (i, j), e in zip(pairs.tolist(), errors, strict=True)
    )
    hit_model, hit_true = {m.model for m in matches}, {m.reference for m in matches}
    return DoorMetrics(
        Detections(found=len(centres), asked=len(true), recalled=len(pairs), errors=errors),
        matches=matches,
        false=tuple(door.id for door in found if door.id not in hit_model),
        missed=tuple(door.id for door in asked if door.id not in hit_true),
    )
