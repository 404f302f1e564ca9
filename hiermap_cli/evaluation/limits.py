"""Limits on metrics: `ate_rmse<=0.10`, and what became of them.

A limit on a metric that could not be measured is missed, never passed.
"""

from __future__ import annotations

import math
import operator
import re
from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.documents.eval_file import LimitOutcome
from hiermap_cli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

COMPARISONS = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
    "==": operator.eq,
}
_LIMIT = re.compile(r"\s*([A-Za-z_][A-Za-z0-9_.-]*)\s*(<=|>=|==|<|>)\s*(\S+)\s*")


class Limit(NamedTuple):
    """A metric, one of `COMPARISONS` and the bound; `text` is how it was given."""

    metric: str
    comparison: str
    bound: float
    text: str

    def holds(self, value: float | None) -> bool:
        """Whether the value keeps the limit; what was not measured does not."""
        return value is not None and bool(COMPARISONS[self.comparison](value, self.bound))


def parse_limit(text: str) -> Limit:
    """The limit in a text such as `ate_rmse<=0.10`.

    Raises:
        UsageError: the text is no NAME, comparison and finite number.
    """
    found = _LIMIT.fullmatch(text)
    bound = _number(found[3]) if found else None
    if found is None or bound is None:
        raise UsageError(
            f"{text!r} is no limit: write NAME<=VALUE with one of {' '.join(COMPARISONS)} and a "
            "finite number, as in 'ate_rmse<=0.10'"
        )
    return Limit(found[1], found[2], bound, text.strip())


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def judge_limits(limits: Iterable[Limit], values: Mapping[str, float]) -> tuple[LimitOutcome, ...]:
    """Each limit against the metrics that were measured, by name."""
    outcomes = []
    for limit in limits:
        value = values.get(limit.metric)
        outcomes.append(
            LimitOutcome(
                limit.metric, limit.comparison, limit.bound, value, limit.holds(value), limit.text
            )
        )
    return tuple(outcomes)
