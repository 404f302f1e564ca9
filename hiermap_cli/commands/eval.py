"""`hiermap eval`: how wrong a map is, and whether it keeps the limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hiermap_cli.commands.boundary import one_line, session
from hiermap_cli.commands.common_options import PATH, ci_options, path_option, said_options
from hiermap_cli.errors import EXIT_LIMIT, EXIT_OK, UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from hiermap_cli.evaluation.judge import Given, Judgement


@click.command("eval", short_help="Measure a run against what is true.")
@click.argument("folder", metavar="DIR", type=PATH)
@path_option(
    "--reference",
    help="Reference map: reference.json, or the YAML file of a map_server map.",
)
@path_option(
    "--rooms",
    metavar="IMAGE",
    help="Room segmentation on the map_server map: one colour for each room.",
)
@path_option("--trajectory", help="True trajectory (TUM).")
@path_option("--relations", help="True relations (Kuemmerle et al.).")
@click.option(
    "--limit",
    "limits",
    multiple=True,
    metavar='"NAME<=VALUE"',
    help="A limit on a metric; may be given many times. A missed one ends with status 3.",
)
@path_option("--limits", "limits_file", help="Limits in a YAML file.")
@path_option("-o", "--output", help="The file to write; DIR/eval.json if not given.")
@ci_options("limits")
@path_option("--overlay", metavar="FILE.svg", help="The model over the reference.")
@click.option("--json", "as_json", is_flag=True, help="Print eval.json on stdout.")
@said_options(quiet="Nothing on stderr but errors, warnings and missed limits.")
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

    Where the run cannot be put onto the reference map, as on that of another building, nothing is
    measured there: a warning says so, and every limit on it is missed.

    Exit status: 0 if all limits hold, 1 if an input cannot be used, 3 if a limit is missed.
    """
    from hiermap_cli.batch.evaluate_run import EVAL, judge_run, read_truth, write_eval
    from hiermap_cli.commands.ci import check_written
    from hiermap_cli.documents.eval_file import FORMAT as EVAL_FORMAT
    from hiermap_cli.documents.eval_file import eval_json
    from hiermap_cli.documents.eval_text import eval_lines, said_of
    from hiermap_cli.documents.own_files import PICTURE, Output, document
    from hiermap_cli.documents.results import RESULT
    from hiermap_cli.evaluation.limits import parse_limit

    target = output if output is not None else folder / EVAL
    state = session()
    state.verbose, state.beside = verbose, target.parent
    if reference is None and trajectory is None and relations is None:
        raise UsageError("give at least one of --reference, --trajectory and --relations")
    if overlay is not None and reference is None:
        raise UsageError("--overlay draws the model over a reference map: give --reference too")
    if overlay is not None and overlay.suffix.lower() != ".svg":
        raise UsageError(f"{overlay}: --overlay writes SVG: give it a name that ends in .svg")
    outputs = [Output("-o", target, document(EVAL_FORMAT))]
    if overlay is not None:
        outputs.append(Output("--overlay", overlay, PICTURE))
    read = (reference, rooms, trajectory, relations, limits_file)
    # Of the run itself, whatever of it is read: all of it is wanted afterwards.
    inputs = [folder / name for name in RESULT.files if name != EVAL]
    inputs += [path for path in read if path is not None]
    check_written(outputs, summary, junit, inputs)
    asked = [parse_limit(text) for text in limits]
    if limits_file is not None:
        from hiermap_cli.batch.limits_file import read_limits  # reads YAML as configurations do

        asked += read_limits(limits_file)
    given = read_truth(reference, trajectory, relations, rooms)
    judgement = judge_run(folder, given, asked)
    evaluation = judgement.document
    write_eval(target, evaluation)
    _write_more(judgement, given, folder.resolve().name, summary, junit, overlay)
    if as_json:
        click.echo(eval_json(evaluation), nl=False)
    if not quiet:
        for line in eval_lines(evaluation):
            click.echo(line, err=True)
    elif not evaluation.passed:  # the reason of the status
        missed = [said_of(one, evaluation) for one in evaluation.limits if not one.passed]
        click.echo(f"hiermap: {one_line('; '.join(missed))}", err=True)
    _warn(judgement, overlay)
    raise click.exceptions.Exit(EXIT_OK if evaluation.passed else EXIT_LIMIT)


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

        write_junit(junit, "hiermap eval", eval_cases(judgement.document, name), "--junit")
    if overlay is not None and judgement.placed is not None and judgement.findings is not None:
        from hiermap_cli.figures.overlay import overlay_svg

        picture = overlay_svg(judgement.placed, judgement.findings, given.reference, given.grid)
        with output_file(overlay, "--overlay") as temporary:
            temporary.write_text(picture, encoding="utf-8", newline="\n")


def _warn(judgement: Judgement, overlay: Path | None) -> None:
    """Says, however quiet the command is, what was asked for and is not there."""
    warnings = list(judgement.document.warnings)
    if overlay is not None and judgement.placed is None:
        warnings.append(f"{overlay}: not drawn: the run was not put onto the reference map")
    for warning in warnings:
        click.echo(f"warning: {one_line(warning)}", err=True)
