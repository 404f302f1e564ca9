"""What a job's result was made of: the key by which a batch knows that a job is done.

The key is the content of every file that decides the result (log, reference, trajectory,
relations), the effective configuration, the limits and the version. Contents are hashed once, by
the worker that reads them anyway, and kept in the result's own job.json with each file's state
(size, times, inode). The next batch only looks at the states; a file whose state changed is
hashed again, and a job whose contents are the same is still done. Where only what a run is judged
by is another, the run is kept and judged again.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from typing import TYPE_CHECKING, Any

import pydantic_core

from hiermap_cli import __version__
from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from hiermap_cli.batch.job import Job

# A file may change twice within a tick of its clock and show one state. Who looks later than this
# after the last change cannot be deceived; some file systems count in twos of seconds.
SETTLED_NS = 3_000_000_000

State = list[Any]


def made_digest(job: Job) -> str:
    """Of what decides a job's run but the content of its log: version and configuration."""
    return _digest([__version__, job.config.digest])


def judged_digest(job: Job) -> str:
    """Of what a job's run is judged by, but the contents of the files."""
    return _digest([list(job.limits), sorted(job.inputs())])


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, separators=(",", ":")).encode()).hexdigest()


def file_state(path: Path) -> State:
    """What changes when the content of a file or folder does: names, sizes, times and inodes.

    Raises:
        InputError: it is not there.
    """
    try:
        if path.is_dir():
            found = sorted(one for one in path.rglob("*") if one.is_file())
            return [[str(one.relative_to(path)), *_state(one)] for one in found]
        return [["", *_state(path)]]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def _state(path: Path) -> State:
    about = path.stat()
    return [about.st_size, about.st_mtime_ns, about.st_ctime_ns, about.st_ino]


def is_settled(state: State, seen_ns: int) -> bool:
    """Whether a state that was seen at `seen_ns` cannot hide a change at the same instant."""
    return all(max(one[2], one[3]) < seen_ns - SETTLED_NS for one in state)


def content_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, or of all names and contents of a folder.

    Raises:
        InputError: it cannot be read.
    """
    try:
        if not path.is_dir():
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        whole = hashlib.sha256()
        for one in sorted(one for one in path.rglob("*") if one.is_file()):
            with one.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            whole.update(json.dumps([str(one.relative_to(path)), digest]).encode())
        return whole.hexdigest()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


class Known:
    """A file as it was seen: its content's digest, its state and when that was."""

    def __init__(self, sha256: str, state: Any, seen_ns: int) -> None:
        self.sha256 = sha256
        self.state = state
        self.seen_ns = seen_ns

    def to_json(self) -> dict[str, Any]:
        """As job.json carries it; the state without line breaks."""
        return {"sha256": self.sha256, "state": self.state, "seen_ns": self.seen_ns}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Known:
        """As `to_json` wrote it.

        Raises:
            KeyError, TypeError: it is something else.
        """
        return cls(values["sha256"], values["state"], values["seen_ns"])

    def is_unchanged(self, path: Path) -> bool:
        """Whether the file's state alone shows that it has the same content.

        Raises:
            InputError: it is not there.
        """
        return file_state(path) == self.state and is_settled(self.state, self.seen_ns)


def look(path: Path, digest: str | None = None) -> Known:
    """A file as it is now; its digest is computed if it is not given."""
    seen_ns, state = time.time_ns(), file_state(path)
    return Known(digest if digest is not None else content_digest(path), state, seen_ns)


class Record:
    """job.json: what a result was made of, and its row of the summary.

    made, judged: digests of what else decides the run, and the judgement of it. run: what the row
    tells of the run alone.
    """

    FORMAT = "hiermap-job"
    VERSION = (1, 0)
    NAME = "job.json"

    def __init__(
        self,
        made: str,
        judged: str,
        inputs: dict[str, Known],
        run: dict[str, Any],
        row: dict[str, Any],
    ) -> None:
        self.made = made
        self.judged = judged
        self.inputs = inputs
        self.run = run
        self.row = row

    @property
    def key(self) -> str:
        """The key: one digest of all."""
        contents = {role: known.sha256 for role, known in sorted(self.inputs.items())}
        return _digest([self.made, self.judged, contents])

    def is_run_of(self, job: Job) -> bool:
        """Whether the job's run, if its log has not changed, is this one."""
        return self.made == made_digest(job)

    def is_of(self, job: Job) -> bool:
        """Whether the job's result, if no file has changed, is this one."""
        return self.is_run_of(job) and self.judged == judged_digest(job)

    def to_bytes(self) -> bytes:
        """As JSON text."""
        document = {
            "format": self.FORMAT,
            "version": list(self.VERSION),
            "key": self.key,
            "made": self.made,
            "judged": self.judged,
            "inputs": {role: known.to_json() for role, known in self.inputs.items()},
            "run": self.run,
            "row": self.row,
        }
        return pydantic_core.to_json(document, indent=1) + b"\n"


def read_record(folder: Path) -> Record | None:
    """The record in a result's folder; None where there is no whole one."""
    try:
        data = (folder / Record.NAME).read_bytes()
        document = pydantic_core.from_json(data)
        if document["format"] != Record.FORMAT or document["version"][0] != Record.VERSION[0]:
            return None
        inputs = {role: Known.from_json(one) for role, one in document["inputs"].items()}
        record = Record(
            document["made"],
            document["judged"],
            inputs,
            dict(document["run"]),
            dict(document["row"]),
        )
        names = set(os.listdir(folder))  # noqa: PTH208 - names alone
        whole = record.key == document["key"] and names.issuperset(record.row["files"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError):
        return None  # no result of a batch, or a damaged one: it is made again
    return record if whole else None
