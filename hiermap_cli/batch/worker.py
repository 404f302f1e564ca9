"""A worker: a process that does jobs. Orders come in, events and outcomes go out.

A worker is an interpreter of its own, started and not forked: nothing of the parent's memory,
threads or locks is in it, and BLAS reads its number of threads before numpy is loaded. It is kept
from job to job, so that its imports are paid for once. Both directions are lines of JSON, on
standard input and on the standard output as it was at the start; what libraries print goes to
standard error. When the parent dies the worker dies at once: the system kills it (Linux), and
its input ends (everywhere).
"""

from __future__ import annotations

import ctypes
import json
import os
import queue
import signal
import sys
import threading
import time
import warnings
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from hiermap_cli.batch.run_log import Observer

if TYPE_CHECKING:
    from collections.abc import Callable

_EVENT_EVERY = 0.2  # seconds between events of one job
_PR_SET_PDEATHSIG = 1
_OUT_OF_MEMORY_BONUS = "500"  # the system that runs out of memory takes a worker first


class Teller(Observer):
    """Tells how a run goes, in few words."""

    def __init__(self, send: Callable[[dict[str, Any]], None], *, watched: bool) -> None:
        self.wants_total = watched
        self._send = send
        self._last = 0.0
        self._done = 0

    def opened(self, log: str, scans: int | None) -> None:
        """Tells how many scans there are."""
        del log
        self._send({"total": scans, "stage": "mapping"})

    def advanced(self, scans: int) -> None:
        """Tells how many scans are done, now and then."""
        self._done += scans
        now = time.monotonic()
        if now - self._last >= _EVENT_EVERY:
            self._last = now
            self._send({"scans": self._done})

    def entered(self, stage: str) -> None:
        """Tells the stage."""
        self._send({"stage": stage})


def main(parent: int) -> None:
    """Does one job after the other until the input ends, or the process `parent` does."""
    _die_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_OUT_OF_MEMORY_BONUS)
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()

    from hiermap_cli.batch.memory import settle_in
    from hiermap_cli.batch.run_job import run_job
    from hiermap_cli.mapping import run  # noqa: F401 - loaded before the first job's clock runs

    settle_in()
    _send(out, {"ready": os.getpid()})
    while True:
        _work(json.loads(lines.get()), out, run_job)


def _work(order: dict[str, Any], out: IO[str], run_job: Callable[..., Any]) -> None:
    """One job."""
    from hiermap_cli.batch.job import Job
    from hiermap_cli.batch.memory import begin_job, set_hard_stop

    job = Job.from_json(order["job"])
    begin_job(job.memory_limit)
    teller = Teller(lambda event: _send(out, {"event": event}), watched=order["watched"])
    outcome = run_job(job, Path(order["folder"]), Path(order["workshop"]), teller)
    set_hard_stop(None)
    _send(out, {"outcome": outcome._asdict()})


def _send(out: IO[str], message: dict[str, Any]) -> None:
    out.write(json.dumps(message) + "\n")
    out.flush()


def _listen(lines: queue.SimpleQueue[str]) -> None:
    """Hands on the lines of the input; at its end nobody is there who wants a result."""
    for line in sys.stdin:
        lines.put(line)
    os.kill(os.getpid(), signal.SIGKILL)


def _die_with(parent: int) -> None:
    """Asks the system to kill this process when its parent dies."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it died before it was asked for
            os.kill(os.getpid(), signal.SIGKILL)
