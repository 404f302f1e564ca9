"""A candidate's figures against a baseline's: `ate_rmse>5%` fails where it rose by more.

Three kinds of bound: `>5%` is a change relative to the baseline's value, `>+0.02` a change in the
metric's own units, `>0.1` the candidate's value itself. `<-5%` and `<-0.02` fail where a metric
fell by more. A metric that one of the two does not have fails: what was not measured never passes.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from hiermap_cli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiermap_cli.documents.eval_file import EvalDocument

Kind = Literal["relative", "change", "value"]
_RULE = re.compile(
    r"\s*([A-Za-z_][A-Za-z0-9_.-]*)\s*(>=|<=|>|<)\s*([-+]?)([0-9.][0-9.eE+-]*)(%?)\s*"
)
_EXAMPLES = "'ate_rmse>5%', 'door_recall<-2%', 'ate_rmse>+0.02' or 'ate_rmse>0.1'"


class Rule(NamedTuple):
    """A condition under which a candidate fails."""

    metric: str
    comparison: str
    bound: float
    kind: Kind
    text: str


class Compared(NamedTuple):
    """A metric of both: baseline and candidate are None where they were not measured."""

    name: str
    units: str
    baseline: float | None
    candidate: float | None

    @property
    def change(self) -> float | None:
        """Candidate less baseline."""
        if self.baseline is None or self.candidate is None:
            return None
        return self.candidate - self.baseline

    @property
    def relative(self) -> float | None:
        """The change over the baseline's size; infinite where that is zero."""
        if self.change is None or self.baseline is None:
            return None
        if self.baseline == 0.0:
            return math.copysign(math.inf, self.change) if self.change else 0.0
        return self.change / abs(self.baseline)


class RuleOutcome(NamedTuple):
    """A rule, whether the candidate passed it, and why in words."""

    rule: Rule
    passed: bool
    said: str


class Comparison(NamedTuple):
    """All metrics of both, in the order of the candidate, and what became of the rules."""

    rows: tuple[Compared, ...]
    outcomes: tuple[RuleOutcome, ...]

    @property
    def passed(self) -> bool:
        """Whether no rule failed."""
        return all(outcome.passed for outcome in self.outcomes)

    def document(self) -> dict[str, Any]:
        """As JSON; a relative change against a baseline of zero is null."""
        return {
            "format": "hiermap-compare",
            "version": [1, 0],
            "passed": self.passed,
            "metrics": [
                {
                    **row._asdict(),
                    "change": row.change,
                    "relative": None if row.relative in (math.inf, -math.inf) else row.relative,
                }
                for row in self.rows
            ],
            "rules": [
                {
                    "metric": one.rule.metric,
                    "fail_if": one.rule.text,
                    "passed": one.passed,
                    "said": one.said,
                }
                for one in self.outcomes
            ],
        }


def parse_rule(text: str) -> Rule:
    """The rule in a text such as `ate_rmse>5%`.

    Raises:
        UsageError: it is none, or one that would fail without any change.
    """
    found = _RULE.fullmatch(text)
    try:
        size = float(found[4]) if found else math.nan
    except ValueError:
        size = math.nan
    if found is None or not math.isfinite(size):
        raise UsageError(f"{text!r} is no condition to fail by: write {_EXAMPLES}")
    name, comparison, sign, percent = found[1], found[2], found[3], found[5]
    bound = -size if sign == "-" else size
    kind: Kind = "relative" if percent else "change" if sign else "value"
    if kind != "value" and (bound > 0.0) == comparison.startswith("<") and bound != 0.0:
        raise UsageError(
            f"{text!r} would fail without any change: to fail where {name} falls write "
            f"'{name}<-{abs(size):g}{percent}', where it rises '{name}>{'' if percent else '+'}"
            f"{abs(size):g}{percent}'"
        )
    return Rule(name, comparison, bound / 100.0 if percent else bound, kind, text.strip())


def compare(baseline: EvalDocument, candidate: EvalDocument, rules: Sequence[Rule]) -> Comparison:
    """All metrics side by side, and which rules the candidate fails."""
    before, after = baseline.values(), candidate.values()
    units = {m.name: m.units for m in (*baseline.metrics, *candidate.metrics)}
    names = [*after, *(name for name in before if name not in after)]
    rows = tuple(Compared(name, units[name], before.get(name), after.get(name)) for name in names)
    by_name = {row.name: row for row in rows}
    outcomes = tuple(
        _judge(rule, by_name.get(rule.metric, Compared(rule.metric, "", None, None)))
        for rule in rules
    )
    return Comparison(rows, outcomes)


def _judge(rule: Rule, row: Compared) -> RuleOutcome:
    if row.candidate is None:
        return RuleOutcome(rule, False, f"{row.name} was not measured in the candidate")
    if rule.kind == "value":
        value: float | None = row.candidate
    else:
        value = row.relative if rule.kind == "relative" else row.change
    if value is None:
        return RuleOutcome(rule, False, f"{row.name} was not measured in the baseline")
    beyond = value - rule.bound
    rounding = 1e-9 * max(1.0, abs(rule.bound))  # 1.05 over 1.0 is a rise of 5 %, not of more
    fails = {
        ">": beyond > rounding,
        "<": beyond < -rounding,
        ">=": value >= rule.bound,
        "<=": value <= rule.bound,
    }[rule.comparison]
    said = f"{row.name} is {row.candidate:.6g}"
    if row.baseline is not None:
        said += f", was {row.baseline:.6g}"
        if row.relative is not None and math.isfinite(row.relative):
            said += f" ({100.0 * row.relative:+.2f} %)"
    return RuleOutcome(rule, not fails, said)
