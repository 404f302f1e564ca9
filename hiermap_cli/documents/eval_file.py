"""eval.json: how right a run is, what could not be measured, and which limits hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import pydantic_core

from hiermap_cli.documents.checks import plain
from hiermap_cli.documents.folder import output_file
from hiermap_cli.documents.own_files import EVAL, EVAL_FORMAT
from hiermap_cli.documents.reading import joined, read_shape
from hiermap_cli.documents.semantics import eval_faults
from hiermap_cli.documents.shapes import EvalDocument as EvalShape
from hiermap_cli.errors import InputError
from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

FORMAT = EVAL_FORMAT
VERSION = (1, 0)


class LimitOutcome(NamedTuple):
    """A limit and what became of it.

    limit: the bound; text: the limit as it was given, `ate_rmse<=0.10`. value: None where the
    metric could not be measured, which never passes.
    """

    metric: str
    comparison: str
    limit: float
    value: float | None
    passed: bool
    text: str


class Unmeasured(NamedTuple):
    """A metric that could not be measured, and why, in words for a person."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class EvalDocument:
    """What `hiermap eval` found.

    metrics: in the order of formats.md, only those that were measured. verdict: one sentence on
    whether the covariances may be trusted, empty where nothing tells. warnings: what was asked for
    and could not be done at all, in words for a person. details: further keys of the document
    (alignment, consistency, errors by name), plain values.
    """

    metrics: tuple[Metric, ...]
    limits: tuple[LimitOutcome, ...] = ()
    unmeasured: tuple[Unmeasured, ...] = ()
    verdict: str = ""
    warnings: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether every limit holds."""
        return all(limit.passed for limit in self.limits)

    def values(self) -> dict[str, float]:
        """The metrics by name."""
        return {metric.name: metric.value for metric in self.metrics}


def eval_json(document: EvalDocument) -> bytes:
    """The document as JSON text.

    Raises:
        UnsoundValueError: a number is not finite: a fault of the program.
    """
    whole = {
        "format": FORMAT,
        "version": list(VERSION),
        "passed": document.passed,
        "verdict": document.verdict,
        "warnings": list(document.warnings),
        "metrics": [metric_json(metric) for metric in document.metrics],
        "limits": [
            {
                "metric": one.metric,
                "comparison": one.comparison,
                "limit": one.limit,
                "value": one.value,
                "passed": one.passed,
                "text": one.text,
            }
            for one in document.limits
        ],
        "not_measured": [one._asdict() for one in document.unmeasured],
        **plain(dict(document.details), "details"),
    }
    return pydantic_core.to_json(whole, indent=1) + b"\n"


def metric_json(metric: Metric) -> dict[str, Any]:
    """A metric as documents carry it."""
    return {
        "name": metric.name,
        "units": metric.units,
        "value": plain(float(metric.value), f"metric {metric.name}"),
        "n": int(metric.n),
    }


def write_eval(path: Path, document: EvalDocument) -> None:
    """Writes eval.json, whole or not at all.

    Raises:
        UsageError: it cannot be written there.
        OutputError: the disk is full or fails.
    """
    data = eval_json(document)
    with output_file(path) as temporary:
        temporary.write_bytes(data)


def read_eval(path: Path) -> EvalDocument:
    """An eval.json, or the one in a folder.

    Raises:
        InputError: it cannot be read, is of another format or newer, or does not hold together.
    """
    if path.is_dir():
        if not (path / EVAL).exists():
            raise InputError(f"{path}: holds no {EVAL}; measure the run with `hiermap eval` first")
        path /= EVAL
    shape = read_shape(path, EvalShape, FORMAT, VERSION)
    faults = eval_faults(shape)
    if faults:
        raise InputError(f"{path}: not a usable evaluation: {joined(faults)}")
    return EvalDocument(
        metrics=tuple(Metric(m.name, m.units, m.value, m.n) for m in shape.metrics),
        limits=tuple(
            LimitOutcome(
                one.metric,
                one.comparison,
                float(one.limit) if isinstance(one.limit, float | int) else 0.0,
                one.value,
                one.passed,
                one.text,
            )
            for one in shape.limits
        ),
        unmeasured=tuple(Unmeasured(one.name, one.reason) for one in shape.not_measured),
        verdict=shape.verdict,
        warnings=tuple(shape.warnings),
    )
