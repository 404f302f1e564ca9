"""`hiermap compare`: a candidate's evaluation against a baseline's."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import click

from hiermap_cli.commands.boundary import one_line, session
from hiermap_cli.commands.common_options import PATH, ci_options, said_options
from hiermap_cli.errors import EXIT_LIMIT, EXIT_OK

if TYPE_CHECKING:
    from pathlib import Path

    from hiermap_cli.evaluation.regression import Compared


@click.command("compare", short_help="Compare two evaluations.")
@click.argument("baseline", metavar="BASELINE", type=PATH)
@click.argument("candidate", metavar="CANDIDATE", type=PATH)
@click.option(
    "--fail-if",
    "rules",
    multiple=True,
    metavar='"NAME>5%"',
    help="Fail where a metric changed so: NAME>5%, NAME<-5%, NAME>+0.02 or NAME>0.1.",
)
@ci_options("conditions")
@click.option("--json", "as_json", is_flag=True, help="Print the comparison as JSON on stdout.")
@said_options(quiet="Nothing on stderr but errors and failed conditions.")
def command(
    baseline: Path,
    candidate: Path,
    rules: tuple[str, ...],
    summary: Path | None,
    junit: Path | None,
    *,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Compare the eval.json of CANDIDATE with that of BASELINE.

    Each is an eval.json or a folder that holds one. A condition on a metric that one of them does
    not have fails.

    \b
        hiermap compare main/eval.json branch/eval.json --fail-if "ate_rmse>5%"

    Exit status: 0 if no condition failed, 1 if a file cannot be used, 3 if one failed.
    """
    import pydantic_core

    from hiermap_cli.commands.ci import check_written, write_summary
    from hiermap_cli.documents.eval_file import read_eval
    from hiermap_cli.documents.eval_text import table_lines
    from hiermap_cli.documents.junit import Case, write_junit
    from hiermap_cli.documents.markdown import figure, markdown_table, markdown_text
    from hiermap_cli.documents.own_files import EVAL
    from hiermap_cli.evaluation.regression import compare, parse_rule

    session().verbose = verbose
    asked = [parse_rule(text) for text in rules]
    inputs = [path / EVAL if path.is_dir() else path for path in (baseline, candidate)]
    check_written([], summary, junit, inputs)
    comparison = compare(read_eval(baseline), read_eval(candidate), asked)
    head = ["metric", "baseline", "candidate", "change", "%"]
    rows = [
        [row.name, figure(row.baseline), figure(row.candidate), figure(row.change), _percent(row)]
        for row in comparison.rows
    ]
    said = [
        f"{one.rule.text}: {'passed' if one.passed else 'FAILED'}, {one.said}"
        for one in comparison.outcomes
    ]
    failed = [line for line, one in zip(said, comparison.outcomes, strict=True) if not one.passed]
    state = "no conditions" if not asked else "passed" if comparison.passed else "**failed**"
    text = f"### hiermap compare: {state}\n\n" + markdown_table(head, rows, numbers=(1, 2, 3, 4))
    text += "".join(f"\n- {markdown_text(line)}" for line in said) + "\n"
    write_summary(text, summary)
    if junit is not None:
        cases = [
            Case(one.rule.text, "compare", failure=None if one.passed else one.said)
            for one in comparison.outcomes
        ]
        write_junit(junit, "hiermap compare", cases, "--junit")
    if as_json:
        click.echo(pydantic_core.to_json(comparison.document(), indent=1))
    if not quiet:
        for line in (*table_lines(head, rows), *said):
            click.echo(line, err=True)
    elif not comparison.passed:  # the reason of the status
        click.echo(f"hiermap: {one_line('; '.join(failed))}", err=True)
    raise click.exceptions.Exit(EXIT_OK if comparison.passed else EXIT_LIMIT)


def _percent(row: Compared) -> str:
    """The relative change; nothing where there is none to tell."""
    if row.relative is None or not math.isfinite(row.relative):
        return "-"
    return f"{100.0 * row.relative:+.1f}"
