"""Small arithmetic that all map metrics share: what cannot be measured is nan, then left out."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.model import Metric

    Array = NDArray[np.float64]


def ratio(part: float, whole: float) -> float:
    """The share; nan where there is nothing to share."""
    return part / whole if whole else math.nan


def rms(errors: Array) -> float:
    """Root mean square; nan of nothing."""
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else math.nan


def measured(*metrics: Metric) -> tuple[Metric, ...]:
    """The metrics whose value is a number: what was not measured is left out."""
    return tuple(metric for metric in metrics if not math.isnan(metric.value))
