"""`hiermap eval`: how wrong a map is, and whether it keeps the limits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiermap_cli.commands.boundary import session
from hiermap_cli.errors import EXIT_LIMIT, EXIT_OK, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiermap_cli.documents.eval_file import EvalDocument
    from hiermap_cli.evaluation.judge import Given, Judgement

PATH = click.Path(path_type=Path)


@click.command("eval", short_help="Measure a run against what is true.")
@click.argument("folder", metavar="DIR", type=PATH)
@click.option(
    "--reference",
    metavar="FILE",
    type=PATH,
    help="Reference map: reference.json, or the YAML file of a map_server map.",
)
@click.option(
    "--rooms",
    metavar="IMAGE",
    type=PATH,
    help="Room segmentation on the map_server map: one colour for each room.",
)
@click.option("--trajectory", metavar="FILE", type=PATH, help="True trajectory (TUM).")
@click.option("--relations", metavar="FILE", type=PATH, help="True relations (Kuemmerle et al.).")
@click.option(
    "--limit",
    "limits",
    multiple=True,
    metavar='"NAME<=VALUE"',
    help="A limit on a metric; may be given many times. A missed one ends with status 3.",
)
@click.option("--limits", "limits_file", metavar="FILE", type=PATH, help="Limits in a YAML file.")
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=PATH,
    help="The file to write; DIR/eval.json if not given.",
)
@click.option("--summary", metavar="FILE", type=PATH, help="A table in Markdown.")
@click.option("--junit", metavar="FILE", type=PATH, help="The limits as JUnit XML.")
@click.option("--overlay", metavar="FILE.svg", type=PATH, help="The model over the reference.")
@click.option("--json", "as_json", is_flag=True, help="Print eval.json on stdout.")
@click.option("-q", "--quiet", is_flag=True, help="Nothing on stderr but errors.")
@click.option("-v", "--verbose", is_flag=True, help="Tracebacks on stderr.")
def command(
    folder: Path,
    reference: Path | None,
    rooms: Path | None,
    trajectory: Path | None,
    relations: Path | None,
    limits: tuple[str, ...],
    limits_file: Path | None,
    output: Path | None,
    summary: Path | None,
    junit: Path | None,
    overlay: Path | None,
    *,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Measure the run in DIR against what is true.

    DIR is what `hiermap run` wrote. Give at least one of --reference, --trajectory and
    --relations. What is written: eval.json, with all metrics, what could not be measured and why,
    and each landmark, area, door and edge with what it was matched with.

    \b
        hiermap eval office --reference reference.json --trajectory truth.tum
        hiermap eval office --reference map.yaml --limit "occupancy_agreement>=0.8"

    Exit status: 0 if all limits hold, 1 if an input cannot be used, 3 if a limit is missed.
    """
    from hiermap_cli.batch.evaluate_run import EVAL, judge_run, read_truth, write_eval
    from hiermap_cli.batch.limits_file import read_limits
    from hiermap_cli.documents.eval_file import eval_json
    from hiermap_cli.evaluation.limits import parse_limit

    target = output if output is not None else folder / EVAL
    state = session()
    state.verbose, state.beside = verbose, target.parent
    if reference is None and trajectory is None and relations is None:
        raise UsageError("give at least one of --reference, --trajectory and --relations")
    asked = [parse_limit(text) for text in limits]
    if limits_file is not None:
        asked += read_limits(limits_file)
    given = read_truth(reference, trajectory, relations, rooms)
    judgement = judge_run(folder, given, asked)
    document = judgement.document
    write_eval(target, document)
    _write_more(judgement, given, folder.resolve().name, summary, junit, overlay)
    if as_json:
        click.echo(eval_json(document), nl=False)
    if not quiet:
        _say(document, overlay, judgement)
    raise click.exceptions.Exit(EXIT_OK if document.passed else EXIT_LIMIT)


def _write_more(
    judgement: Judgement,
    given: Given,
    name: str,
    summary: Path | None,
    junit: Path | None,
    overlay: Path | None,
) -> None:
    from hiermap_cli.commands.ci import write_summary
    from hiermap_cli.documents.eval_text import eval_cases, eval_markdown
    from hiermap_cli.documents.folder import output_file

    write_summary(eval_markdown(judgement.document, name), summary)
    if junit is not None:
        from hiermap_cli.documents.junit import write_junit

        write_junit(junit, "hiermap eval", eval_cases(judgement.document, name))
    if overlay is not None and judgement.placed is not None and judgement.findings is not None:
        from hiermap_cli.figures.overlay import overlay_svg

        picture = overlay_svg(judgement.placed, judgement.findings, given.reference, given.grid)
        with output_file(overlay) as temporary:
            temporary.write_text(picture, encoding="utf-8", newline="\n")


def _say(document: EvalDocument, overlay: Path | None, judgement: Judgement) -> None:
    from hiermap_cli.documents.eval_text import eval_lines

    lines: Sequence[str] = eval_lines(document)
    for line in lines:
        click.echo(line, err=True)
    if overlay is not None and judgement.placed is None:
        # Without a place of the model nothing is measured on the map, all for the same reason.
        reasons = {one.name: one.reason for one in document.unmeasured}
        click.echo(f"{overlay}: not drawn, {reasons['wall_rmse']}", err=True)
