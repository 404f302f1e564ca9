"""What `eval`, `compare` and `batch` do for CI: a job summary where the system offers one."""

from __future__ import annotations

import os
from pathlib import Path

import click


def write_summary(text: str, file: Path | None) -> None:
    """Markdown into a file, and at the end of the job's summary where CI offers one.

    Raises:
        UsageError: the file cannot be written.
    """
    from hiermap_cli.documents.folder import output_file

    if file is not None:
        with output_file(file) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    offered = os.environ.get("GITHUB_STEP_SUMMARY")
    if offered and (file is None or not _is_same(Path(offered), file)):
        try:
            with Path(offered).open("a", encoding="utf-8", newline="\n") as summary:
                summary.write(text + "\n")
        except OSError as error:
            # The evaluation itself is sound; a summary that CI cannot take must not fail it.
            click.echo(f"hiermap: {offered}: no job summary was written ({error})", err=True)


def _is_same(first: Path, second: Path) -> bool:
    return first.resolve() == second.resolve()
