"""An evaluation for people and for CI: plain lines, Markdown, JUnit cases."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hiermap_cli.documents.junit import Case
from hiermap_cli.documents.markdown import figure, markdown_table, markdown_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hiermap_cli.documents.eval_file import EvalDocument, LimitOutcome

_NAMED = 20  # things that are named in a line; the rest are counted


def said_of(limit: LimitOutcome, document: EvalDocument) -> str:
    """What became of a limit, in words; of what was not measured with the reason."""
    state = "" if limit.value is None else "holds, " if limit.passed else "missed, "
    return f"{limit.text}: {state}{found(limit, document)}"


def found(limit: LimitOutcome, document: EvalDocument) -> str:
    """What was found of a limit's metric: its value, or why there is none."""
    if limit.value is not None:
        return f"it is {figure(limit.value)}"
    reasons = {one.name: one.reason for one in document.unmeasured}
    reason = reasons.get(limit.metric) or _unknown(limit.metric, document)
    return f"could not be measured: {reason}"


def _unknown(name: str, document: EvalDocument) -> str:
    """Why a metric is neither among those measured nor among those that could not be."""
    from difflib import get_close_matches

    known = [m.name for m in document.metrics] + [one.name for one in document.unmeasured]
    near = get_close_matches(name, known, n=1)
    return f"the run has no metric of that name{f'; did you mean {near[0]}?' if near else ''}"


def eval_lines(document: EvalDocument) -> list[str]:
    """The evaluation as lines of plain text."""
    width = max((len(m.name) for m in document.metrics), default=0)
    lines = [
        f"{m.name:<{width}}  {figure(m.value):>9} {_units(m.units):<5} n = {m.n}"
        for m in document.metrics
    ]
    for reason, names in _by_reason(document).items():
        lines.append(f"not measured, {reason}: {', '.join(names)}")
    lines += [f"{what}: {text}" for what, text in _named_errors(document.details.get("errors", {}))]
    if document.verdict:
        lines.append(f"verdict: {document.verdict}")
    lines += [f"limit {said_of(limit, document)}" for limit in document.limits]
    return lines


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table as lines of plain text, its first column to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    return [
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (head, *rows)
    ]


def _units(units: str) -> str:
    return "" if units == "1" else units


def _by_reason(document: EvalDocument) -> dict[str, list[str]]:
    reasons: dict[str, list[str]] = {}
    for one in document.unmeasured:
        reasons.setdefault(one.reason, []).append(one.name)
    return reasons


def _named_errors(errors: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[tuple[str, str]]:
    """What is false and what is missed, by name."""
    said = []
    for status in ("false", "missed"):
        for kind in ("landmarks", "areas", "doors", "edges"):
            names = [_name(entry) for entry in errors.get(kind, ()) if entry["status"] == status]
            if names:
                # Of landmarks only corners are looked for one by one.
                what = "corners" if kind == "landmarks" else kind
                more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
                said.append((f"{status} {what}", ", ".join(names[:_NAMED]) + more))
    return said


def _name(entry: Mapping[str, Any]) -> str:
    """`D4`, `A1 - A2`, or a place for what has no name."""
    if "areas" in entry and entry["status"] != "missed":
        return " - ".join(entry["areas"])
    name = entry.get("id") or entry.get("reference")
    if isinstance(name, list):
        return " - ".join(str(part) for part in name)
    if name is not None:
        return str(name)
    x, y = entry["true"]
    return f"({x:.2f}, {y:.2f})"


def eval_markdown(document: EvalDocument, title: str) -> str:
    """The evaluation as Markdown: state, verdict, limits and metrics in one table, what is off."""
    missed = [limit for limit in document.limits if not limit.passed]
    state = "no limits" if not document.limits else "passed" if not missed else "**failed**"
    by_metric: dict[str, list[LimitOutcome]] = {}
    for limit in document.limits:
        by_metric.setdefault(limit.metric, []).append(limit)
    rows = []
    for m in document.metrics:
        limits = by_metric.pop(m.name, [])
        rows.append([m.name, figure(m.value), _units(m.units), str(m.n), *_limit_cells(limits)])
    for name, limits in by_metric.items():
        value = limits[0].value
        shown = "not measured" if value is None else figure(value)
        rows.append([name, shown, "", "", *_limit_cells(limits)])
    parts = [f"### hiermap eval: {markdown_text(title)}: {state}\n"]
    parts += [f"**Warning:** {markdown_text(warning)}\n" for warning in document.warnings]
    if document.verdict:
        parts.append(f"{markdown_text(document.verdict)}\n")
    head = ["metric", "value", "units", "n", "limit", "state"]
    parts.append(markdown_table(head, rows, numbers=(1, 3)))
    named = _named_errors(document.details.get("errors", {}))
    parts += (
        ["".join(f"- {what}: {markdown_text(text)}\n" for what, text in named)] if named else []
    )
    reasons = _by_reason(document)
    if reasons:
        lines = [
            f"- {', '.join(names)}: {markdown_text(reason)}\n" for reason, names in reasons.items()
        ]
        parts.append(
            "<details><summary>not measured</summary>\n\n" + "".join(lines) + "\n</details>\n"
        )
    return "\n".join(parts)


def _limit_cells(limits: list[LimitOutcome]) -> tuple[str, str]:
    said = ", ".join(limit.text.removeprefix(limit.metric).strip() for limit in limits)
    if not limits:
        return "", ""
    return said, "passed" if all(limit.passed for limit in limits) else "MISSED"


def eval_cases(document: EvalDocument, suite: str) -> list[Case]:
    """One JUnit case for each limit; without limits, one for the evaluation itself."""
    figures = {m.name: f"{m.value:.9g}" for m in document.metrics}
    said = "\n".join((*(f"warning: {one}" for one in document.warnings), document.verdict))
    if not document.limits:
        return [Case("eval", suite, output=said, properties=figures)]
    return [
        Case(
            limit.text,
            suite,
            failure=None if limit.passed else said_of(limit, document),
            properties=figures if i == 0 else None,
            output=said if i == 0 else "",
        )
        for i, limit in enumerate(document.limits)
    ]
