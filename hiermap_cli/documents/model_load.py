"""Reading of model.json back into the values of `mapping.model`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hiermap_cli.documents.model_file import FORMAT, VERSION
from hiermap_cli.documents.reading import joined, read_shape
from hiermap_cli.documents.semantics import model_faults
from hiermap_cli.documents.shapes import ModelDocument
from hiermap_cli.errors import InputError
from hiermap_cli.mapping.model import (
    AreaModel,
    DoorModel,
    EnvironmentModel,
    Estimate,
    HierarchicalModel,
    LandmarkModel,
    PointFeature,
    SegmentFeature,
)

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hiermap_cli.documents import shapes

    Array = NDArray[np.float64]


def load_model(path: Path) -> HierarchicalModel:
    """The model in a model.json.

    Raises:
        InputError: the file cannot be read, is of another format or of a newer major version, or
            something in it does not hold (shape, ids, sizes, covariances).
    """
    document = read_shape(path, ModelDocument, FORMAT, VERSION)
    faults = model_faults(document)
    if faults:
        raise InputError(f"{path}: not a usable model: {joined(faults)}")
    return model_of(document)


def model_of(document: ModelDocument) -> HierarchicalModel:
    """The values of a document whose shape and semantics hold."""
    heads = {area.id: area for area in document.environment.areas}
    environment = document.environment
    return HierarchicalModel(
        environment=EnvironmentModel(
            robot=_estimate_of(environment.robot),
            areas=tuple((area.id, _estimate_of(area.estimate)) for area in environment.areas),
            covariance=_frozen(environment.covariance),
            doors=tuple(_door_of(door) for door in environment.doors),
        ),
        areas=tuple(
            AreaModel(
                id=area.id,
                kind=heads[area.id].kind,
                entered_by=heads[area.id].entered_by,
                robot=_estimate_of(area.robot),
                landmarks=tuple((one.id, _estimate_of(one.estimate)) for one in area.landmarks),
                covariance=_frozen(area.covariance),
                extent=_frozen(area.extent).reshape(-1, 2),
            )
            for area in document.areas
        ),
        landmarks=tuple(_landmark_of(landmark) for landmark in document.landmarks),
    )


def _frozen(values: Any) -> Array:
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


def _estimate_of(estimate: shapes.PoseEstimate) -> Estimate:
    return Estimate(estimate.frame, _frozen(estimate.mean), _frozen(estimate.covariance))


def _door_of(door: shapes.Door) -> DoorModel:
    return DoorModel(
        id=door.id,
        areas=(door.areas[0], door.areas[1]),
        landmarks=tuple(door.landmarks),
        width=door.width,
        estimate=_estimate_of(door.estimate),
        crossings=door.crossings,
    )


def _landmark_of(landmark: shapes.Landmark) -> LandmarkModel:
    return LandmarkModel(
        id=landmark.id,
        area=landmark.area,
        kind=landmark.kind,
        binds=tuple(landmark.binds),
        robot=_estimate_of(landmark.robot),
        features=tuple(_feature_of(feature) for feature in landmark.features),
        covariance=_frozen(landmark.covariance),
        observations=landmark.observations,
        utility=landmark.utility,
    )


def _feature_of(feature: shapes.SegmentShape | shapes.PointShape) -> SegmentFeature | PointFeature:
    if feature.kind == "point":
        return PointFeature(_frozen(feature.mean), _frozen(feature.covariance))
    return SegmentFeature(
        p=feature.p,
        q=feature.q,
        line_type=feature.type,
        covariance=_frozen(feature.covariance),
        endpoints=_frozen(feature.endpoints),
        endless=(feature.endless[0], feature.endless[1]),
    )
