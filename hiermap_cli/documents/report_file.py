"""report.json: what was read, with what, how it went, and what the run says about its errors."""

from __future__ import annotations

import platform
from typing import TYPE_CHECKING, Any

import numpy as np
import pydantic_core

from hiermap_cli import __version__
from hiermap_cli.documents.checks import plain

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hiermap_cli.config import Config
    from hiermap_cli.mapping.model import Event, Metric

FORMAT = "hiermap-report"
VERSION = (1, 0)


def report_json(
    *,
    source: Mapping[str, Any],
    config: Config,
    metrics: Sequence[Metric],
    events: Sequence[Event],
    timing: Mapping[str, float],
    consistency: Mapping[str, Any] | None = None,
) -> bytes:
    """The report as JSON text.

    Args:
        source: the key `input` of formats.md: log, sha256, topics, counts, dropped by reason.
        config: the effective configuration.
        metrics: in the order wanted.
        events: in the order of time.
        timing: seconds by stage.
        consistency: what the innovations say of the covariances, `MapResult.consistency`.

    Raises:
        UnsoundValueError: a number is not finite, or a value has no JSON form.
    """
    document = {
        "format": FORMAT,
        "version": list(VERSION),
        "input": plain(dict(source), "input"),
        "software": {
            "hiermap": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
        "config": config.model_dump(mode="json"),
        "metrics": [
            {
                "name": metric.name,
                "units": metric.units,
                "value": plain(metric.value, f"metric {metric.name}"),
                "n": int(metric.n),
            }
            for metric in metrics
        ],
        "events": [
            {
                "t": event.stamp_ns / 1e9,
                "kind": event.kind,
                **plain(dict(event.details), f"event {event.kind}"),
            }
            for event in events
        ],
        "consistency": plain(dict(consistency or {}), "consistency"),
        "timing": {stage: plain(seconds, f"timing {stage}") for stage, seconds in timing.items()},
    }
    return pydantic_core.to_json(document, indent=1) + b"\n"
