"""The reports of a batch: summary.json, JUnit and Markdown, whatever became of each job.

Rows are read from the results' own records one after the other, so that ten thousand jobs take no
more memory than ten.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import pydantic_core

from hiermap_cli.batch.content import read_record
from hiermap_cli.batch.job import Outcome, failed
from hiermap_cli.batch.quantities import bytes_text, seconds_text
from hiermap_cli.documents import own_files
from hiermap_cli.documents.folder import output_file
from hiermap_cli.documents.junit import Case, write_junit
from hiermap_cli.documents.markdown import figure, markdown_table
from hiermap_cli.errors import EXIT_INPUT, EXIT_LIMIT, EXIT_OK

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from hiermap_cli.batch.job import Job

FORMAT = "hiermap-summary"
VERSION = (1, 0)
SUMMARY, JUNIT, MARKDOWN = "summary.json", "junit.xml", "summary.md"
# How each begins: what begins otherwise is none of a batch.
REPORTS = {
    SUMMARY: own_files.document(FORMAT),
    JUNIT: own_files.JUNIT,
    MARKDOWN: own_files.MARKDOWN,
}
_WRITTEN = ("name", "status", "reason", "metrics", "seconds", "peak_memory", "scans", "limits",
            "warnings")  # fmt: skip
_MAX_DONE = 500  # rows of jobs without a fault in Markdown: CI systems show a megabyte at most

Row = dict[str, Any]


class Tally(NamedTuple):
    """How many jobs ended how."""

    done: int = 0
    limit_missed: int = 0
    failed: int = 0

    @property
    def total(self) -> int:
        """All jobs."""
        return sum(self)

    @property
    def exit_status(self) -> int:
        """The status of the whole: 1 goes before 3."""
        return EXIT_INPUT if self.failed else EXIT_LIMIT if self.limit_missed else EXIT_OK

    def text(self) -> str:
        """In words: `12 jobs: 10 done, 1 missed a limit, 1 failed`."""
        parts = [f"{self.done} done"]
        if self.limit_missed:
            parts.append(f"{self.limit_missed} missed a limit")
        if self.failed:
            parts.append(f"{self.failed} failed")
        return f"{self.total} {'job' if self.total == 1 else 'jobs'}: {', '.join(parts)}"


def row_of(job: Job, folder: Path, failures: Mapping[str, Outcome]) -> Row:
    """The row of a job: of its result, or of how it failed."""
    outcome = failures.get(job.name)
    if outcome is None:
        record = read_record(folder / job.name)
        if record is not None:
            return {"name": job.name, **record.row}
        outcome = failed(job.name, "its result was removed while the batch was at work")
    return {
        "name": job.name,
        "status": "failed",
        "reason": outcome.reason,
        "metrics": {},
        "seconds": outcome.seconds,
        "peak_memory": outcome.peak_memory,
    }


def write_reports(folder: Path, rows: Callable[[], Iterable[Row]]) -> Tally:
    """Writes the three reports; `rows` is called anew for each.

    Raises:
        UsageError, OutputError: they cannot be written.
    """
    tally = write_summary(folder / SUMMARY, rows())
    write_junit(folder / JUNIT, "hiermap batch", map(_case, rows()))
    with output_file(folder / MARKDOWN) as temporary:
        text = "".join(_markdown(rows(), tally))
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return tally


def write_summary(path: Path, rows: Iterable[Row]) -> Tally:
    """Writes summary.json, a row a line, and counts.

    Raises:
        UsageError, OutputError: it cannot be written.
    """
    counts = dict.fromkeys(Tally._fields, 0)
    head = pydantic_core.to_json({"format": FORMAT, "version": list(VERSION)})
    with output_file(path) as temporary, temporary.open("wb") as file:
        file.write(head[:-1] + b',\n "jobs": [')
        between = b"\n  "
        for row in rows:
            counts[row["status"]] += 1
            written = {key: row[key] for key in _WRITTEN if key in row}
            file.write(between + pydantic_core.to_json(written, inf_nan_mode="null"))
            between = b",\n  "
        file.write(b"\n ]}\n")
    return Tally(**counts)


def _case(row: Row) -> Case:
    """A job as a test: a missed limit is a failure, a job without a result an error."""
    return Case(
        name=row["name"],
        suite="hiermap.batch",
        failure=row["reason"] if row["status"] == "limit_missed" else None,
        error=row["reason"] if row["status"] == "failed" else None,
        seconds=row["seconds"],
        output="\n".join(row.get("warnings", [])),
    )


def _markdown(rows: Iterable[Row], tally: Tally) -> Iterator[str]:
    """What went wrong first, then what went well, in the order of the jobs."""
    yield f"## hiermap batch: {tally.text()}\n\n"
    bad: list[Sequence[str]] = []
    good: list[Sequence[str]] = []
    for row in rows:
        if row["status"] != "done":
            bad.append(_cells(row))
        elif len(good) < _MAX_DONE:
            good.append(_cells(row))
    for kind, last in ((bad, "reason"), (good, "limits")):
        if kind:
            head = ("job", "status", "scans", "time", "memory", last)
            yield markdown_table(head, kind, numbers=(2, 3, 4)) + "\n"
    if tally.done > len(good):
        yield f"and {tally.done - len(good)} more jobs done; all are in {SUMMARY}\n"


def _cells(row: Row) -> list[str]:
    limits = [
        f"{one['text']}: {figure(one['value']) if one['value'] is not None else 'not measured'}"
        for one in row.get("limits", [])
    ]
    seconds, memory = row["seconds"], row["peak_memory"]
    return [
        row["name"],
        row["status"].replace("_", " "),
        str(row.get("scans", "")),
        seconds_text(seconds) if seconds is not None else "",
        bytes_text(memory) if memory is not None else "",
        row["reason"] if row["status"] == "failed" else "; ".join(limits),
    ]
