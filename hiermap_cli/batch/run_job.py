"""One job from its log to its folder: what a worker does."""

from __future__ import annotations

import errno
import os
import re
import shutil
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiermap_cli.batch.content import (
    Known,
    Record,
    content_digest,
    file_state,
    judged_digest,
    look,
    made_digest,
    read_record,
)
from hiermap_cli.batch.evaluate_run import EVAL, evaluate_run, write_eval
from hiermap_cli.batch.job import EVALUATED_BY, Job, Outcome, failed, kept_outcome, too_much_memory
from hiermap_cli.batch.memory import peak_bytes
from hiermap_cli.batch.remote import fetch, remote_state, remove, shown
from hiermap_cli.batch.run_log import MappedLog, Observer, RunOutcome
from hiermap_cli.config import Config
from hiermap_cli.documents.eval_text import found
from hiermap_cli.documents.folder import check_output, output_folder
from hiermap_cli.documents.own_files import Contents, document
from hiermap_cli.documents.results import RESULT
from hiermap_cli.errors import HiermapError, InputError
from hiermap_cli.evaluation.limits import parse_limit

if TYPE_CHECKING:
    from hiermap_cli.documents.eval_file import EvalDocument

# Only what a batch has made is replaced by a batch. A record that is no JSON any more is damaged.
RESULT_OF_A_JOB = Contents(
    "an earlier result of a batch",
    (Record.NAME,),
    {**RESULT.files, Record.NAME: document(Record.FORMAT) + rb"|\s*\{?\s*\Z"},
)
_TRACEBACK = 20_000  # characters


def run_job(job: Job, folder: Path, workshop: Path, observer: Observer | None = None) -> Outcome:
    """Runs a job, or finds that it is done.

    Whatever goes wrong is told in the outcome; nothing is raised.

    Args:
        job: what to do.
        folder: the batch's folder; the result is `folder / job.name`.
        workshop: a folder on the same disk for what is not whole yet.
        observer: is told how the run goes.
    """
    begin = time.perf_counter()
    try:
        return _Work(job, folder, workshop, observer or Observer(), begin).outcome()
    except HiermapError as error:
        reason = _without_workshop(str(error), job, workshop)
        return failed(job.name, reason, time.perf_counter() - begin)
    except MemoryError:
        reason = too_much_memory(job.memory_limit)
        return failed(job.name, reason, time.perf_counter() - begin)
    except Exception as error:  # noqa: BLE001 - a fault in one job is no fault of the batch
        seconds = time.perf_counter() - begin
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return failed(job.name, f"the disk is full ({error.strerror})", seconds)
        text = "".join(traceback.format_exception(error))[-_TRACEBACK:]
        reason = f"a fault of the program ({type(error).__name__}: {str(error)[:200]})"
        return failed(job.name, reason, seconds, text)


def _without_workshop(reason: str, job: Job, workshop: Path) -> str:
    """A reason that names the log and the result as a person knows them."""
    place = re.escape(str(workshop))
    reason = re.sub(rf"{place}/\.[^/:]*\.[0-9a-f]{{8}}\b", lambda _: job.name, reason)
    if job.is_remote:
        reason = re.sub(rf"{place}/[^/:]*", lambda _: shown(job.log), reason)
    return reason


class _Work:
    def __init__(
        self, job: Job, folder: Path, workshop: Path, observer: Observer, begin: float
    ) -> None:
        self._job = job
        self._target = folder / job.name
        self._workshop = workshop
        self._observer = observer
        self._begin = begin

    def outcome(self) -> Outcome:
        """Done before, or done now.

        Raises:
            HiermapError: the log cannot be used, or the result not be written.
        """
        job = self._job
        earlier = read_record(self._target)
        if earlier is not None and not earlier.is_run_of(job):
            earlier = None
        if not job.is_remote:
            return self._from(Path(job.log), None, earlier)
        state = remote_state(job.log)
        if earlier is not None and state is not None and earlier.inputs["log"].state == state:
            kept = self._kept(earlier, None, state)
            if kept is not None:
                return kept
        self._workshop.mkdir(parents=True, exist_ok=True)
        self._observer.entered("fetching")
        fetched = fetch(job.log, self._workshop)
        try:
            return self._from(fetched, state, earlier)
        finally:
            remove(fetched)

    def _from(self, log: Path, state: Any, earlier: Record | None) -> Outcome:
        if earlier is not None:
            kept = self._kept(earlier, log, state)
            if kept is not None:
                return kept
        return self._made(log, state)

    def _kept(self, earlier: Record, log: Path | None, state: Any) -> Outcome | None:
        """The earlier result, if its log had the same content; `log` None: it is known to have.

        The states of the files as they are now are written into its record. Where the run is
        judged by something else than it was, it is judged again.
        """
        job = self._job
        now = {"log": earlier.inputs["log"] if log is None else look(log)}
        if now["log"].sha256 != earlier.inputs["log"].sha256:
            return None
        if state is not None:
            now["log"] = Known(now["log"].sha256, state, now["log"].seen_ns)
        others = {role: Path(path) for role, path in job.inputs().items() if role != "log"}
        now |= {role: look(path) for role, path in others.items()}
        judged = judged_digest(job)
        record = Record(earlier.made, judged, now, earlier.run, earlier.row)
        if record.key != earlier.key:
            return self._judged_again(record)
        _replace(self._target / Record.NAME, record.to_bytes(), self._workshop)
        return kept_outcome(job.name, earlier.row)

    def _judged_again(self, record: Record) -> Outcome:
        """The earlier run under new limits, or against another truth."""
        with output_folder(
            self._target, RESULT_OF_A_JOB, force=True, workshop=self._workshop
        ) as folder:
            for name in record.row["files"]:
                if name != EVAL:
                    _same_file(self._target / name, folder / name)
            row = self._row(record.run, self._evaluated(folder), folder)
            record = Record(record.made, record.judged, record.inputs, record.run, row)
            (folder / Record.NAME).write_bytes(record.to_bytes())
        return kept_outcome(self._job.name, row)._replace(kept=False)

    def _made(self, log: Path, state: Any) -> Outcome:
        """The job, done."""
        job = self._job
        seen_ns = time.time_ns()
        paths = {role: Path(path) for role, path in job.inputs().items()} | {"log": log}
        before = {role: file_state(path) for role, path in paths.items()}
        files = list(paths.values())
        check_output(self._target, RESULT_OF_A_JOB, force=True, inputs=files)
        self._take_away()
        mapped = MappedLog([log], Config.model_validate(job.config.values), self._observer)
        # Of a single file the run has hashed the very bytes that it read.
        known = {"log": mapped.source.sha256} if log.is_file() else {}
        digests = {role: known.get(role) or content_digest(path) for role, path in paths.items()}
        with output_folder(
            self._target, RESULT_OF_A_JOB, force=True, inputs=files, workshop=self._workshop
        ) as folder:
            run = mapped.write(folder)
            del mapped
            document = self._evaluated(folder)
            for role, path in paths.items():
                if file_state(path) != before[role]:
                    raise InputError(f"{path}: changed while it was read; it is tried again")
            if state is not None:
                before["log"] = state
            inputs = {role: Known(digests[role], before[role], seen_ns) for role in before}
            facts = self._facts(run)
            row = self._row(facts, document, folder)
            record = Record(made_digest(job), judged_digest(job), inputs, facts, row)
            (folder / Record.NAME).write_bytes(record.to_bytes())
        return kept_outcome(job.name, row)._replace(kept=False)

    def _take_away(self) -> None:
        """Removes what a batch has made of other contents, whatever becomes of this job."""
        if not (self._target / Record.NAME).exists():
            return
        self._workshop.mkdir(parents=True, exist_ok=True)
        aside = self._workshop / "replaced"
        self._target.rename(aside)
        shutil.rmtree(aside)

    def _evaluated(self, folder: Path) -> EvalDocument | None:
        """eval.json, where there is something to evaluate by, or a limit to hold."""
        job = self._job
        files = {
            role: Path(path) for role in EVALUATED_BY if (path := getattr(job, role)) is not None
        }
        if not files and not job.limits:
            return None
        self._observer.entered("evaluating")
        limits = [parse_limit(text) for text in job.limits]
        document = evaluate_run(folder, **files, limits=limits)
        write_eval(folder / EVAL, document)
        return document

    def _facts(self, run: RunOutcome) -> dict[str, Any]:
        """What the row tells of the run alone."""
        return {
            "metrics": {metric.name: float(metric.value) for metric in run.metrics},
            "seconds": time.perf_counter() - self._begin,
            "peak_memory": peak_bytes(),
            "scans": run.scans,
            "warnings": list(run.warnings),
        }

    def _row(
        self, facts: dict[str, Any], document: EvalDocument | None, folder: Path
    ) -> dict[str, Any]:
        """The row of summary.json, but for the name; and what the reports beside it show."""
        values = dict(facts["metrics"])
        limits: list[dict[str, Any]] = []
        missed: list[str] = []
        warnings = list(facts["warnings"])
        if document is not None:
            warnings += document.warnings
            values |= {name: float(value) for name, value in document.values().items()}
            limits = [
                {"text": one.text, "value": one.value, "passed": one.passed}
                for one in document.limits
            ]
            missed = [
                f"{one.text}: {found(one, document)}" for one in document.limits if not one.passed
            ]
        return {
            "status": "limit_missed" if missed else "done",
            "reason": "; ".join(missed) or None,
            **facts,
            "metrics": values,
            "warnings": warnings,
            "limits": limits,
            "files": sorted(one.name for one in folder.iterdir()),
        }


def _same_file(path: Path, new: Path) -> None:
    """A second name for a file that nobody writes any more; a copy where there are none."""
    try:
        os.link(path, new)
    except OSError:
        shutil.copyfile(path, new)


def _replace(path: Path, data: bytes, workshop: Path) -> None:
    """Replaces a small file in one step."""
    workshop.mkdir(parents=True, exist_ok=True)
    temporary = workshop / path.name
    temporary.write_bytes(data)
    temporary.replace(path)
