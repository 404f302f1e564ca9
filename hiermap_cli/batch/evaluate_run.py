"""One folder of results against what is known to be true: the body of `hiermap eval`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiermap_cli.documents.eval_file import EVAL, EvalDocument, write_eval
from hiermap_cli.documents.model_load import load_model
from hiermap_cli.documents.reading import read_shape
from hiermap_cli.documents.reference import read_reference
from hiermap_cli.documents.relations import read_relations
from hiermap_cli.documents.report_file import FORMAT as REPORT_FORMAT
from hiermap_cli.documents.report_file import VERSION as REPORT_VERSION
from hiermap_cli.documents.results import MODEL, REPORT, TRAJECTORY, TRAJECTORY_COVARIANCE
from hiermap_cli.documents.shapes import ReportDocument
from hiermap_cli.documents.trajectories import read_covariances
from hiermap_cli.documents.tum import read_tum
from hiermap_cli.errors import InputError
from hiermap_cli.evaluation.against import map_metrics, trajectory_metrics
from hiermap_cli.evaluation.limits import judge_limits
from hiermap_cli.evaluation.relations import relations_metrics
from hiermap_cli.mapping.model import Metric, Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from hiermap_cli.evaluation.limits import Limit

__all__ = ["EVAL", "evaluate_run", "write_eval"]


def evaluate_run(
    folder: Path,
    *,
    reference: Path | None = None,
    trajectory: Path | None = None,
    relations: Path | None = None,
    limits: Sequence[Limit] = (),
) -> EvalDocument:
    """How right the run in `folder` is, and whether it keeps the limits.

    Args:
        folder: what `hiermap run` wrote.
        reference: a reference map.
        trajectory: the true trajectory (TUM), in the reference map's frame.
        relations: true relations (Kuemmerle et al.).
        limits: on the metrics of eval.json or of the run's report.json.

    Raises:
        InputError: the folder holds no run, or a reference cannot be used.
    """
    model_file = folder / MODEL
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected what `hiermap run` wrote")
    model = load_model(model_file)
    run = _trajectory(folder)
    metrics: list[Metric] = []
    if trajectory is not None:
        truth = read_tum(trajectory)
        metrics += trajectory_metrics(run, truth)
        if reference is not None:
            metrics += map_metrics(model, run, read_reference(reference), truth)
    if relations is not None:
        true = read_relations(relations)
        metrics += relations_metrics(run.stamps_ns, run.poses, true).metrics()
    values = {metric.name: metric.value for metric in (*_own(folder), *metrics)}
    return EvalDocument(tuple(metrics), judge_limits(limits, values))


def _trajectory(folder: Path) -> Trajectory:
    poses = read_tum(folder / TRAJECTORY)
    covariances = read_covariances(folder / TRAJECTORY_COVARIANCE)
    return Trajectory(poses.stamps_ns, poses.poses, covariances.covariances)


def _own(folder: Path) -> list[Metric]:
    """What the run says of itself; nothing where it has no report."""
    path = folder / REPORT
    if not path.exists():
        return []
    report = read_shape(path, ReportDocument, REPORT_FORMAT, REPORT_VERSION)
    return [Metric(m.name, m.units, m.value, m.n) for m in report.metrics]
