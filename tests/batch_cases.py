"""Batches as a user starts them: small logs, jobs files, and `hiermap batch` as a real process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import log_cases
import yaml

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PATIENCE = 60.0  # seconds that a test waits for what must happen soon
RESULT = {
    "job.json",
    "map.svg",
    "model.json",
    "report.json",
    "trajectory.tum",
    "trajectory_covariance.txt",
    "trajectory_filter.tum",
}
SAME_BYTES = (
    "model.json",
    "trajectory.tum",
    "trajectory_filter.tum",
    "trajectory_covariance.txt",
    "eval.json",
)


def small_log(path: Path, *, turn: int = 0, scans: int = 4) -> Path:
    """A log of a few scans; another `turn` is another content."""
    lines = log_cases.carmen_text().splitlines(keepends=True)
    ends = [index for index, line in enumerate(lines) if line.startswith("FLASER")]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"# {turn}\n" + "".join(lines[: ends[scans]]))
    return path


def makings(folder: Path) -> dict[str, tuple[int, int]]:
    """Which making of each job's model lies there: one made again differs.

    Inode and time of the last writing: a file system may give a new file the inode of the
    one it replaced.
    """
    found = {}
    for path in folder.rglob("model.json"):
        if ".partial" not in path.parts:
            stat = path.stat()
            found[path.parent.name] = (stat.st_ino, stat.st_mtime_ns)
    return found


def small_logs(folder: Path, count: int) -> list[Path]:
    return [small_log(folder / f"log{index}.log", turn=index) for index in range(count)]


def hanging_log(path: Path) -> Path:
    """A pipe that nobody writes into: whoever opens it waits for ever."""
    os.mkfifo(path)
    return path


def write_jobs(path: Path, jobs: list[dict[str, Any]], **defaults: Any) -> Path:
    document = {"defaults": defaults, "jobs": jobs} if defaults else {"jobs": jobs}
    path.write_text(yaml.safe_dump(document, sort_keys=False))
    return path


def jobs_of(logs: list[Path], path: Path, **defaults: Any) -> Path:
    """A job for each log; logs beside the jobs file are named so that all may be moved."""
    entries = [
        {"name": log.stem, "log": log.name if log.parent == path.parent else str(log)}
        for log in logs
    ]
    return write_jobs(path, entries, **defaults)


def arguments(*words: object) -> list[str]:
    """With one worker, where nothing else is said: each takes half a second to start."""
    said = [str(word) for word in words]
    if "--workers" not in said and "--scheduler" not in said:
        said += ["--workers", "1"]
    return [sys.executable, "-m", "hiermap_cli", "batch", *said]


def batch(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """`hiermap batch` to its end."""
    return subprocess.run(
        arguments(*words), capture_output=True, text=True, check=False, timeout=300, **options
    )


@contextmanager
def started(*words: object, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """`hiermap batch` at work; killed at the end if it still is."""
    process = subprocess.Popen(
        arguments(*words),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def until(condition: Callable[[], Any], what: str = "it") -> Any:
    """The first true value of `condition`."""
    deadline = time.monotonic() + PATIENCE
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.01)


def children(pid: int) -> list[int]:
    """The processes that a process has started and not yet lost."""
    running = [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]
    return [one for one in running if parent_of(one) == pid]


def parent_of(pid: int) -> int | None:
    """None for a process that is gone, or dead and not yet waited for."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    state, parent, *_ = text.rpartition(")")[2].split()
    return None if state == "Z" else int(parent)


def is_alive(pid: int) -> bool:
    return parent_of(pid) is not None


def reader_of(pipe: Path, process: subprocess.Popen[str]) -> int:
    """The worker that has opened a hanging log; it hangs on, for the pipe is held open here."""
    return reader_below(pipe, [process.pid])[0]


def reader_below(pipe: Path, parents: list[int]) -> tuple[int, int]:
    """The same for workers of several parents: the reader, and which parent has started it."""
    GRIPS.append(until(partial(_other_end, pipe), "somebody who reads the pipe"))
    return until(partial(_found_reader, pipe, parents), "the worker that has opened it")


def _found_reader(pipe: Path, parents: list[int]) -> tuple[int, int] | None:
    for parent in parents:
        for one in children(parent):
            if str(pipe) in open_files(one):
                return one, parent
    return None


GRIPS: list[int] = []  # ends of pipes, held open as long as the tests run


def _other_end(pipe: Path) -> int | None:
    try:
        return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
    except OSError:
        return None  # nobody reads


def open_files(pid: int) -> set[str]:
    """The paths that a process has open; one that closes meanwhile is left out."""
    found = set()
    for one in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):
            found.add(os.readlink(one))  # noqa: PTH115 - a Path would be made of "pipe:[7]"
    return found


def summary(folder: Path) -> dict[str, dict[str, Any]]:
    """The rows of summary.json by name."""
    document = json.loads((folder / "summary.json").read_text())
    assert document["format"] == "hiermap-summary"
    names = [row["name"] for row in document["jobs"]]
    assert len(names) == len(set(names))
    return {row["name"]: row for row in document["jobs"]}


def statuses(folder: Path) -> dict[str, str]:
    return {name: row["status"] for name, row in summary(folder).items()}


def results(folder: Path) -> dict[str, dict[str, bytes]]:
    """Every result that is there, whole, with what must be the same whoever makes it."""
    found = {}
    for path in sorted(folder.rglob("job.json")):
        if ".partial" in path.parts:
            continue
        result = path.parent
        assert {one.name for one in result.iterdir()} >= RESULT, result
        json.loads(path.read_bytes())
        json.loads((result / "model.json").read_bytes())
        json.loads((result / "report.json").read_bytes())
        found[str(result.relative_to(folder))] = {
            name: (result / name).read_bytes() for name in SAME_BYTES if (result / name).exists()
        }
    return found


def leftovers(folder: Path) -> list[str]:
    """What lies in a batch's folder that is neither a result, nor a report, nor a lock."""
    known = {"summary.json", "summary.md", "junit.xml"}
    out = []
    for path in folder.rglob("*"):
        inside = any((one / "job.json").exists() for one in (path, *path.parents))
        holds = path.is_dir() and any(path.rglob("job.json"))
        report = path.name in known or path.name.startswith(".lock")
        if not inside and not holds and not report:
            out.append(str(path.relative_to(folder)))
    return out
