"""Small arithmetic that all map metrics share: what cannot be measured is nan, then left out."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class Detections(NamedTuple):
    """Things of one kind that were found, against those that were asked for.

    found, asked: how many. recalled: how many of those asked for were found. errors: (matched,)
    metres between each thing found and what it truly is.
    """

    found: int
    asked: int
    recalled: int
    errors: Array

    @property
    def matched(self) -> int:
        """How many of the things found are there."""
        return len(self.errors)

    def metrics(self, kind: str) -> tuple[Metric, ...]:
        """Precision, recall and error of `kind`, those that could be measured."""
        return measured(
            Metric(f"{kind}_precision", "1", ratio(self.matched, self.found), self.found),
            Metric(f"{kind}_recall", "1", ratio(self.recalled, self.asked), self.asked),
            Metric(f"{kind}_rmse", "m", rms(self.errors), self.matched),
        )


def ratio(part: float, whole: float) -> float:
    """The share; nan where there is nothing to share."""
    return part / whole if whole else math.nan


def rms(errors: Array) -> float:
    """Root mean square; nan of nothing."""
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else math.nan


def measured(*metrics: Metric) -> tuple[Metric, ...]:
    """The metrics whose value is a number: what was not measured is left out."""
    return tuple(metric for metric in metrics if not math.isnan(metric.value))
