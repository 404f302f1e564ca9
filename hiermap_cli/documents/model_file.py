"""model.json: the three levels as text.

The text is a function of the values alone: keys in one order, floats in their shortest form that
reads back to the same bits. It is made area by area, so that a large model is never held twice.
"""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any

import numpy as np
import pydantic_core

from hiermap_cli.documents.checks import UnsoundValueError, sound_array, sound_covariance
from hiermap_cli.mapping.model import PointFeature

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hiermap_cli.mapping.model import (
        AreaModel,
        EnvironmentModel,
        Estimate,
        HierarchicalModel,
        LandmarkModel,
        SegmentFeature,
    )

    Array = NDArray[np.float64]

FORMAT = "hiermap-model"
VERSION = (1, 0)


def write_model(file: IO[bytes], model: HierarchicalModel) -> None:
    """The model as JSON.

    Raises:
        UnsoundValueError: a value is not finite, or a covariance is none: a fault of the program.
    """
    for part in _parts(model):
        file.write(part)


def model_json(model: HierarchicalModel) -> bytes:
    """What `write_model` writes."""
    return b"".join(_parts(model))


def _parts(model: HierarchicalModel) -> Iterator[bytes]:
    kinds = {area.id: area for area in model.areas}
    yield b'{"format":' + _json(FORMAT) + b',"version":' + _json(list(VERSION))
    yield b',"environment":' + _json(_environment(model.environment, kinds))
    yield b',"areas":['
    for index, area in enumerate(model.areas):
        yield (b"," if index else b"") + _json(_area(area))
    yield b'],"landmarks":['
    for index, landmark in enumerate(model.landmarks):
        yield (b"," if index else b"") + _json(_landmark(landmark))
    yield b"]}\n"


def _json(value: Any) -> bytes:
    return pydantic_core.to_json(value, inf_nan_mode="null")  # everything is checked before


def _estimate(estimate: Estimate, what: str, block: Array | None = None) -> dict[str, Any]:
    """An ESTIMATE; `block` is its part of a joint covariance that was checked before."""
    mean = sound_array(estimate.mean, f"the mean of {what}")
    return {
        "frame": estimate.frame,
        "mean": mean.tolist(),
        "covariance": _covariance(estimate.covariance, what, block),
    }


def _covariance(C: Array, what: str, block: Array | None) -> list[list[float]]:
    """C as lists; where it is the block of a sound joint covariance, it is sound as well."""
    sound = block if block is not None and np.array_equal(C, block) else sound_covariance(C, what)
    rows: list[list[float]] = sound.tolist()
    return rows


def _joint(C: Array, size: int, what: str) -> Array:
    if C.shape != (size, size):
        raise UnsoundValueError(f"the covariance of {what} has shape {C.shape}, not {size} rows")
    return sound_covariance(C, what)


def _block(C: Array, first: int, size: int = 3) -> Array:
    """The diagonal block of `size` rows that begins at row `first`."""
    return C[first : first + size, first : first + size]


def _environment(environment: EnvironmentModel, areas: dict[str, AreaModel]) -> dict[str, Any]:
    C = _joint(environment.covariance, 3 + 3 * len(environment.areas), "the environment")
    return {
        "frame": "g",
        "robot": _estimate(environment.robot, "the robot in g", _block(C, 0)),
        "areas": [
            {
                "id": id_,
                "kind": areas[id_].kind,
                "estimate": _estimate(estimate, f"area {id_} in g", _block(C, 3 + 3 * index)),
                "entered_by": areas[id_].entered_by,
            }
            for index, (id_, estimate) in enumerate(environment.areas)
        ],
        "covariance": C.tolist(),
        "doors": [
            {
                "id": door.id,
                "areas": list(door.areas),
                "landmarks": list(door.landmarks),
                "width": float(sound_array(door.width, f"the width of {door.id}")),
                "estimate": _estimate(door.estimate, f"door {door.id} in g"),
                "crossings": int(door.crossings),
            }
            for door in environment.doors
        ],
    }


def _area(area: AreaModel) -> dict[str, Any]:
    C = _joint(area.covariance, 3 + 3 * len(area.landmarks), f"area {area.id}")
    extent = sound_array(area.extent, f"the extent of {area.id}").reshape(-1, 2)
    return {
        "id": area.id,
        "frame": area.id,
        "robot": _estimate(area.robot, f"the robot in {area.id}", _block(C, 0)),
        "landmarks": [
            {
                "id": id_,
                "estimate": _estimate(
                    estimate, f"landmark {id_} in {area.id}", _block(C, 3 + 3 * index)
                ),
            }
            for index, (id_, estimate) in enumerate(area.landmarks)
        ],
        "covariance": C.tolist(),
        "extent": extent.tolist(),
    }


def _landmark(landmark: LandmarkModel) -> dict[str, Any]:
    C = _joint(landmark.covariance, 3 + 2 * len(landmark.features), f"landmark {landmark.id}")
    return {
        "id": landmark.id,
        "area": landmark.area,
        "frame": landmark.id,
        "kind": landmark.kind,
        "binds": list(landmark.binds),
        "robot": _estimate(landmark.robot, f"the robot in {landmark.id}", _block(C, 0)),
        "features": [
            _feature(feature, f"feature {index} of {landmark.id}", _block(C, 3 + 2 * index, 2))
            for index, feature in enumerate(landmark.features)
        ],
        "covariance": C.tolist(),
        "observations": int(landmark.observations),
        "utility": float(sound_array(landmark.utility, f"the utility of {landmark.id}")),
    }


def _feature(feature: SegmentFeature | PointFeature, what: str, block: Array) -> dict[str, Any]:
    covariance = _covariance(feature.covariance, what, block)
    if isinstance(feature, PointFeature):
        mean = sound_array(feature.mean, what).tolist()
        return {"kind": "point", "mean": mean, "covariance": covariance}
    p, q = sound_array((feature.p, feature.q), what).tolist()
    return {
        "kind": "segment",
        "p": p,
        "q": q,
        "type": int(feature.line_type),
        "covariance": covariance,
        "endpoints": sound_array(feature.endpoints, what).reshape(2, 2).tolist(),
        "endless": [bool(end) for end in feature.endless],
    }
