"""One folder of results against what is known to be true: the body of `hiermap eval`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hiermap_cli.documents.eval_file import EvalDocument, write_eval
from hiermap_cli.documents.model_load import load_model
from hiermap_cli.documents.own_files import EVAL
from hiermap_cli.documents.reading import read_shape
from hiermap_cli.documents.reference import ReferenceMap, read_reference
from hiermap_cli.documents.relations import read_relations
from hiermap_cli.documents.report_file import FORMAT as REPORT_FORMAT
from hiermap_cli.documents.report_file import VERSION as REPORT_VERSION
from hiermap_cli.documents.results import MODEL, REPORT, TRAJECTORY, TRAJECTORY_COVARIANCE
from hiermap_cli.documents.shapes import ReportDocument
from hiermap_cli.documents.trajectories import read_covariances
from hiermap_cli.documents.tum import read_tum
from hiermap_cli.errors import InputError, UsageError
from hiermap_cli.evaluation.judge import Given, Judgement, Run, judge
from hiermap_cli.evaluation.visibility import View
from hiermap_cli.mapping.model import Metric, Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from hiermap_cli.documents.occupancy import OccupancyGrid
    from hiermap_cli.evaluation.limits import Limit

__all__ = ["EVAL", "evaluate_run", "judge_run", "read_run", "read_truth", "write_eval"]

YAML = (".yaml", ".yml")


def evaluate_run(
    folder: Path,
    *,
    reference: Path | None = None,
    trajectory: Path | None = None,
    relations: Path | None = None,
    limits: Sequence[Limit] = (),
    rooms: Path | None = None,
) -> EvalDocument:
    """How right the run in `folder` is, and whether it keeps the limits.

    Args:
        folder: what `hiermap run` wrote.
        reference: a reference map (JSON), or a map of map_server (YAML).
        trajectory: the true trajectory (TUM), in the reference map's frame or not.
        relations: true relations (Kuemmerle et al.).
        limits: on the metrics of eval.json or of the run's report.json.
        rooms: an image of rooms, each of one colour, that lies on the map of map_server.

    Raises:
        InputError: the folder holds no run, or a reference cannot be used.
        UsageError: `rooms` without a map of map_server.
    """
    given = read_truth(reference, trajectory, relations, rooms)
    return judge_run(folder, given, limits).document


def judge_run(folder: Path, given: Given, limits: Sequence[Limit] = ()) -> Judgement:
    """The same with what is true read already, and with what a picture needs."""
    needs_model = given.reference is not None or given.grid is not None
    return judge(read_run(folder, needs_model=needs_model), given, limits)


def read_truth(
    reference: Path | None,
    trajectory: Path | None,
    relations: Path | None,
    rooms: Path | None = None,
) -> Given:
    """What is held to be true, from its files.

    Raises:
        InputError: one of them cannot be used.
        UsageError: `rooms` without a map of map_server.
    """
    named = {"reference": reference, "trajectory": trajectory, "relations": relations}
    names = {name: str(path) for name, path in named.items() if path is not None}
    reference_map: ReferenceMap | None = None
    grid: OccupancyGrid | None = None
    if reference is not None and reference.suffix.lower() in YAML:
        from hiermap_cli.documents.occupancy import read_map_server

        grid = read_map_server(reference)
        if rooms is not None:
            from hiermap_cli.documents.rooms_image import read_rooms
            from hiermap_cli.evaluation.rooms import reference_of_rooms

            names["rooms"] = str(rooms)
            reference_map = reference_of_rooms(grid, read_rooms(rooms, grid))
    elif rooms is not None:
        raise UsageError("--rooms is an image that lies on a map: give --reference MAP.yaml too")
    elif reference is not None:
        reference_map = read_reference(reference)
    return Given(
        reference=reference_map,
        grid=grid,
        truth=None if trajectory is None else read_tum(trajectory),
        relations=None if relations is None else read_relations(relations),
        names=names,
    )


def read_run(folder: Path, *, needs_model: bool = True) -> Run:
    """What `hiermap run` wrote into a folder.

    Only the trajectory must be there, and the model where it is asked for: any trajectory can be
    judged.

    Raises:
        InputError: it holds no run, or a file in it is damaged.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected what `hiermap run` wrote")
    if not (folder / TRAJECTORY).exists():
        raise InputError(f"{folder}: holds no {TRAJECTORY}; expected what `hiermap run` wrote")
    poses = read_tum(folder / TRAJECTORY)
    covariances = np.zeros((0, 3, 3))
    if (path := folder / TRAJECTORY_COVARIANCE).exists():
        read = read_covariances(path)
        if not np.array_equal(read.stamps_ns, poses.stamps_ns):
            raise InputError(f"{path}: its stamps are not those of {TRAJECTORY} beside it")
        covariances = read.covariances
    report = _report(folder)
    model = load_model(folder / MODEL) if needs_model or (folder / MODEL).exists() else None
    run = Run(Trajectory(poses.stamps_ns, poses.poses, covariances), model)
    if report is None:
        return run
    extra: dict[str, Any] = report.model_extra or {}
    return run._replace(
        own=tuple(Metric(m.name, m.units, m.value, m.n) for m in report.metrics),
        consistency=extra.get("consistency") or {},
        events=[event.model_dump() for event in report.events],
        view=_view(report.input.model_extra or {}),
    )


def _report(folder: Path) -> ReportDocument | None:
    path = folder / REPORT
    if not path.exists():
        return None
    return read_shape(path, ReportDocument, REPORT_FORMAT, REPORT_VERSION)


def _view(source: dict[str, Any]) -> View:
    """The laser's view by report.json's `input.laser`; unlimited where it does not say."""
    laser = source.get("laser") or {}
    first, last = laser.get("first_angle"), laser.get("last_angle")
    field = 2.0 * math.pi
    # Only a view that is symmetric about the robot's heading can be told by its width.
    if first is not None and last is not None and abs(first + last) < 0.05:
        field = min(float(last - first), field)
    return View(float(laser.get("range_max") or math.inf), field)
