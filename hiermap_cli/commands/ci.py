"""What `eval`, `compare` and `batch` do for CI: a job summary where the system offers one."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hiermap_cli.documents.own_files import Output


def write_summary(text: str, file: Path | None) -> None:
    """Markdown into a file, and at the end of the job's summary where CI offers one.

    A file that is the job's summary is only added to: other steps may have written there.

    Raises:
        UsageError: the file cannot be written.
    """
    from hiermap_cli.documents.folder import output_file
    from hiermap_cli.documents.own_files import is_same_file

    offered = os.environ.get("GITHUB_STEP_SUMMARY")
    if file is not None and not (offered and is_same_file(Path(offered), file)):
        with output_file(file, "--summary") as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    if offered:
        try:
            with Path(offered).open("a", encoding="utf-8", newline="\n") as summary:
                summary.write(text + "\n")
        except OSError as error:
            # The evaluation itself is sound; a summary that CI cannot take must not fail it.
            click.echo(f"hiermap: {offered}: no job summary was written ({error})", err=True)


def check_written(
    others: Iterable[Output], summary: Path | None, junit: Path | None, inputs: Iterable[Path]
) -> None:
    """Whether all files that a command is asked to write may be written, before its work.

    Args:
        others: those besides --summary and --junit.
        summary: of --summary; the job's own summary of CI may hold what others wrote.
        junit: of --junit.
        inputs: what is read, none of which may be written.

    Raises:
        UsageError: one may not be written.
    """
    from hiermap_cli.documents.folder import check_files
    from hiermap_cli.documents.own_files import JUNIT, MARKDOWN, Output, is_same_file

    outputs = list(others)
    if summary is not None:
        offered = os.environ.get("GITHUB_STEP_SUMMARY")
        added = offered and is_same_file(Path(offered), summary)
        outputs.append(Output("--summary", summary, b"" if added else MARKDOWN))
    if junit is not None:
        outputs.append(Output("--junit", junit, JUNIT))
    check_files(outputs, inputs)
