"""What must hold between the parts of a document, beyond its shape.

Each function gives one line per fault, with its path, and raises nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.documents.checks import covariance_fault, first_bad_covariance

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from hiermap_cli.documents import shapes

    Array = NDArray[np.float64]
    Rows = list[list[float]]
    Judge = Callable[[Array], str | None]  # what is wrong with a covariance (n, n)

_BLOCK_TOLERANCE = 1e-6  # of the deviations, between an estimate and its block of the joint


def model_faults(model: shapes.ModelDocument) -> list[str]:
    """Faults of a model: ids, frames, sizes and covariances."""
    # All at once takes a quarter of the time; where one is wrong each is looked at by itself.
    judge: Judge = (lambda _: None) if _are_sound(_covariances(model)) else covariance_fault
    faults = _environment_faults(model, judge)
    landmarks = {landmark.id: landmark for landmark in model.landmarks}
    for index, area in enumerate(model.areas):
        faults += _area_faults(f"areas[{index}]", area, landmarks, judge)
    areas = {area.id: {one.id for one in area.landmarks} for area in model.areas}
    for index, landmark in enumerate(model.landmarks):
        path = f"landmarks[{index}]"
        if landmark.area not in areas:
            faults.append(f"{path}.area: {landmark.area!r} is no area of this model")
        elif landmark.id not in areas[landmark.area]:
            faults.append(f"{path}: {landmark.id!r} is not listed in area {landmark.area!r}")
        faults += _landmark_faults(path, landmark, judge)
    faults += _repeated("landmarks", (landmark.id for landmark in model.landmarks))
    return faults


def _covariances(model: shapes.ModelDocument) -> Iterator[Rows]:
    """Every covariance of a model."""
    yield model.environment.covariance
    estimates = [model.environment.robot]
    estimates += [area.estimate for area in model.environment.areas]
    estimates += [door.estimate for door in model.environment.doors]
    for area in model.areas:
        yield area.covariance
        estimates += [area.robot, *(landmark.estimate for landmark in area.landmarks)]
    for landmark in model.landmarks:
        yield landmark.covariance
        yield from (feature.covariance for feature in landmark.features)
        estimates.append(landmark.robot)
    yield from (estimate.covariance for estimate in estimates)


def _are_sound(covariances: Iterable[Rows]) -> bool:
    """Whether all of them are square and covariances."""
    by_size: dict[int, list[Rows]] = {}
    for one in covariances:
        if any(len(row) != len(one) for row in one):
            return False
        by_size.setdefault(len(one), []).append(one)
    return all(first_bad_covariance(np.array(alike)) is None for alike in by_size.values())


def _environment_faults(model: shapes.ModelDocument, judge: Judge) -> list[str]:
    environment = model.environment
    area_ids = [area.id for area in model.areas]
    listed = [area.id for area in environment.areas]
    door_ids = {door.id for door in environment.doors}
    faults = _repeated("environment.areas", listed) + _repeated("areas", area_ids)
    faults += _repeated("environment.doors", (door.id for door in environment.doors))
    if sorted(listed) != sorted(area_ids):
        faults.append(f"environment.areas: lists {sorted(listed)}, areas holds {sorted(area_ids)}")
    estimates = [("environment.robot", environment.robot)]
    for index, area in enumerate(environment.areas):
        path = f"environment.areas[{index}]"
        estimates.append((f"{path}.estimate", area.estimate))
        if area.entered_by is not None and area.entered_by not in door_ids:
            faults.append(f"{path}.entered_by: {area.entered_by!r} is no door of this model")
    faults += _joint_faults("environment", "g", estimates, environment.covariance, judge)
    landmarks = {landmark.id for landmark in model.landmarks}
    for index, door in enumerate(environment.doors):
        path = f"environment.doors[{index}]"
        faults += _estimate_faults(f"{path}.estimate", "g", door.estimate, judge)
        faults += [f"{path}.areas: no area {id_!r}" for id_ in door.areas if id_ not in listed]
        faults += [
            f"{path}.landmarks: no landmark {id_!r}"
            for id_ in door.landmarks
            if id_ not in landmarks
        ]
    return faults


def _area_faults(
    path: str, area: shapes.Area, landmarks: dict[str, shapes.Landmark], judge: Judge
) -> list[str]:
    faults = _repeated(f"{path}.landmarks", (landmark.id for landmark in area.landmarks))
    if area.frame != area.id:
        faults.append(f"{path}.frame: is {area.frame!r}, not the area's id {area.id!r}")
    estimates = [(f"{path}.robot", area.robot)]
    for index, landmark in enumerate(area.landmarks):
        here = f"{path}.landmarks[{index}]"
        estimates.append((f"{here}.estimate", landmark.estimate))
        known = landmarks.get(landmark.id)
        if known is None:
            faults.append(f"{here}: no landmark {landmark.id!r}")
        elif known.area != area.id:
            faults.append(f"{here}: landmark {landmark.id!r} belongs to area {known.area!r}")
    return faults + _joint_faults(path, area.id, estimates, area.covariance, judge)


def _landmark_faults(path: str, landmark: shapes.Landmark, judge: Judge) -> list[str]:
    faults = []
    if landmark.frame != landmark.id:
        faults.append(f"{path}.frame: is {landmark.frame!r}, not the landmark's id {landmark.id!r}")
    faults += _repeated(f"{path}.binds", landmark.binds)
    blocks = [(f"{path}.robot", np.array(landmark.robot.covariance))]
    faults += _estimate_faults(f"{path}.robot", landmark.id, landmark.robot, judge)
    for index, feature in enumerate(landmark.features):
        here = f"{path}.features[{index}]"
        blocks.append((here, np.array(feature.covariance)))
        if fault := judge(blocks[-1][1]):
            faults.append(f"{here}.covariance: {fault}")
    return faults + _blocks_faults(path, landmark.covariance, blocks, judge)


def _joint_faults(
    path: str,
    frame: str,
    estimates: list[tuple[str, shapes.PoseEstimate]],
    covariance: Rows,
    judge: Judge,
) -> list[str]:
    """Faults of estimates in `frame`, of their joint covariance, and between the two."""
    faults = [
        fault for here, one in estimates for fault in _estimate_faults(here, frame, one, judge)
    ]
    blocks = [(here, np.array(one.covariance)) for here, one in estimates]
    return faults + _blocks_faults(path, covariance, blocks, judge)


def _blocks_faults(
    path: str, covariance: Rows, blocks: list[tuple[str, Array]], judge: Judge
) -> list[str]:
    size = sum(len(block) for _, block in blocks)
    widths = {len(row) for row in covariance}
    if len(covariance) != size or widths != {size}:
        shown = f"{len(covariance)} x {'/'.join(map(str, sorted(widths)))}"
        return [f"{path}.covariance: is {shown}; its state vector has {size} components"]
    C = np.array(covariance)
    if fault := judge(C):
        return [f"{path}.covariance: {fault}"]
    faults = []
    first = 0
    deviations = np.sqrt(np.diagonal(C))
    allowed = _BLOCK_TOLERANCE * np.outer(deviations, deviations) + 1e-15
    for here, block in blocks:
        inside = np.s_[first : first + len(block), first : first + len(block)]
        if (np.abs(C[inside] - block) > allowed[inside]).any():
            faults.append(f"{here}.covariance: differs from its block of {path}.covariance")
        first += len(block)
    return faults


def _estimate_faults(
    path: str, frame: str, estimate: shapes.PoseEstimate, judge: Judge
) -> list[str]:
    faults = []
    if estimate.frame != frame:
        faults.append(f"{path}.frame: is {estimate.frame!r}, not {frame!r}")
    theta = estimate.mean[2]
    if not -np.pi - 1e-9 < theta <= np.pi + 1e-9:
        faults.append(f"{path}.mean: its angle {theta} is not wrapped to (-pi, pi]")
    if fault := judge(np.array(estimate.covariance)):
        faults.append(f"{path}.covariance: {fault}")
    return faults


def _repeated(path: str, ids: Iterable[str]) -> list[str]:
    seen: set[str] = set()
    faults = []
    for id_ in ids:
        if id_ in seen:
            faults.append(f"{path}: {id_!r} is given more than once")
        seen.add(id_)
    return faults


def report_faults(report: shapes.ReportDocument) -> list[str]:
    """Faults of a report: metrics of one name."""
    return _repeated("metrics", (metric.name for metric in report.metrics))


def eval_faults(evaluation: shapes.EvalDocument) -> list[str]:
    """Faults of an evaluation: metrics of one name, a verdict that its limits do not bear."""
    faults = _repeated("metrics", (metric.name for metric in evaluation.metrics))
    for index, limit in enumerate(evaluation.limits):
        if limit.value is None and limit.passed:
            faults.append(f"limits[{index}]: passed without a value")
    if evaluation.passed != all(limit.passed for limit in evaluation.limits):
        faults.append(f"passed: is {str(evaluation.passed).lower()}, its limits say otherwise")
    return faults
