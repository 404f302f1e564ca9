"""The parent's side of a worker: starts it, gives it a job, watches it, and ends it.

Each worker has pipes of its own and shares no lock or queue with any other, so that one that is
killed, in whatever instant, can harm none but itself.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Any

from hiermap_cli.batch.job import Job, Outcome, failed, too_much_memory
from hiermap_cli.batch.memory import resident_bytes
from hiermap_cli.batch.quantities import seconds_text

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_PROGRAM = """
import sys
sys.path[:] = sys.argv[2:]
from hiermap_cli.batch.worker import main
main(int(sys.argv[1]))
"""
START_LIMIT = 120.0  # seconds for the imports of a worker; on a busy network disk they take long
_WATCH_EVERY = 0.02  # seconds between looks at a worker with a memory limit
_LOOK_EVERY = 0.2  # ... and at others, for whether it shall stop
_LAST_WORDS = 2000  # bytes of standard error that are read when a worker dies

Event = dict[str, Any]


class Stopped(Exception):  # noqa: N818 - no error
    """The batch is being stopped: there is no outcome."""


class WorkerProcess:
    """A worker that is started when it is first needed, and again after it died.

    Args:
        folder: the batch's.
        workshop: a folder for this worker alone; what is left in it by a death is removed.
        keep_open: file descriptors that the worker inherits: the lock of the folder.
        watched: somebody wants to know how many scans a log has.
        should_stop: asked some times a second.
    """

    def __init__(
        self,
        folder: Path,
        workshop: Path,
        *,
        keep_open: tuple[int, ...] = (),
        watched: bool = False,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self._folder = folder
        self._workshop = workshop
        self._keep_open = keep_open
        self._watched = watched
        self._should_stop = should_stop
        self._process: subprocess.Popen[bytes] | None = None
        self._stderr: IO[bytes] | None = None
        self._buffer = b""
        self._reason = ""
        self._peak = 0

    @property
    def pid(self) -> int | None:
        """The process id while there is one."""
        return self._process.pid if self._process is not None else None

    def run(self, job: Job, tell: Callable[[Event], None]) -> Outcome:
        """Does a job, within its limits.

        Raises:
            Stopped: the batch is being stopped; the worker is dead.
        """
        begin = time.monotonic()
        try:
            died = self._ensure_started()
            if died is not None:
                return failed(job.name, died, time.monotonic() - begin)
            tell({"pid": self.pid})
            begin = time.monotonic()
            return self._watch(job, tell, begin)
        except BaseException:
            self.kill()
            raise

    def _watch(self, job: Job, tell: Callable[[Event], None], begin: float) -> Outcome:
        order = {
            "job": job.to_json(),
            "folder": str(self._folder),
            "workshop": str(self._workshop),
            "watched": self._watched,
        }
        every = _WATCH_EVERY if job.memory_limit is not None else _LOOK_EVERY
        self._peak = 0
        if not self._order(order):
            return failed(job.name, self._death(), 0.0)
        while True:
            for message in self._messages(every):
                if "outcome" in message:
                    return self._measured(Outcome(**message["outcome"]))
                tell(message.get("event", {}))
            if self._process is None:
                return failed(job.name, self._reason, time.monotonic() - begin)
            if self._should_stop():
                raise Stopped
            broken = self._broken_limit(job, time.monotonic() - begin)
            if broken is not None:
                self.kill()
                return broken

    def _broken_limit(self, job: Job, seconds: float) -> Outcome | None:
        """The outcome of a job that takes too long or too much."""
        if job.time_limit is not None and seconds > job.time_limit:
            reason = f"took longer than it may (limit {seconds_text(job.time_limit)})"
            return self._measured(failed(job.name, reason, seconds))
        assert self._process is not None
        if job.memory_limit is not None:
            held = resident_bytes(self._process.pid) or 0
            self._peak = max(self._peak, held)
            if held > job.memory_limit:
                reason = too_much_memory(job.memory_limit)
                return self._measured(failed(job.name, reason, seconds))
        return None

    def _measured(self, outcome: Outcome) -> Outcome:
        """With the peak that was seen from outside, where the worker could not tell its own."""
        if outcome.peak_memory is None and self._peak:
            return outcome._replace(peak_memory=self._peak)
        return outcome

    # --- the process ---

    def _ensure_started(self) -> str | None:
        """Starts the worker where there is none; why that failed, or None.

        Raises:
            Stopped: the batch is being stopped.
        """
        if self._process is not None and self._process.poll() is None:
            return None
        self.kill()
        try:
            self._start()
        except OSError as error:
            return f"no worker can be started ({error.strerror or error})"
        begin = time.monotonic()
        while True:
            for message in self._messages(_LOOK_EVERY):
                if "ready" in message:
                    return None
            if self._process is None:
                return self._reason
            if self._should_stop():
                raise Stopped
            if time.monotonic() - begin > START_LIMIT:
                self.kill()
                return f"the worker did not start within {seconds_text(START_LIMIT)}"

    def _start(self) -> None:
        self._buffer, self._reason = b"", ""
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - read after the worker's death
        # The worker imports from where this process does, or it might be another hiermap.
        command = [sys.executable, "-P", "-c", _PROGRAM, str(os.getpid()), *sys.path]
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            env={**os.environ, **ONE_THREAD},
            pass_fds=self._keep_open,
            bufsize=0,
        )

    def _order(self, order: dict[str, Any]) -> bool:
        """Gives the worker its order; False if it has just died."""
        assert self._process is not None
        assert self._process.stdin is not None
        data = json.dumps(order).encode() + b"\n"
        try:
            while data:  # a raw pipe may take less than all
                data = data[self._process.stdin.write(data) :]
        except BrokenPipeError:
            return False
        return True

    def _messages(self, seconds: float) -> list[dict[str, Any]]:
        """What the worker says within that time; afterwards it may be known to be dead."""
        assert self._process is not None
        assert self._process.stdout is not None
        poll = select.poll()
        poll.register(self._process.stdout, select.POLLIN)
        if not poll.poll(1e3 * seconds):
            return []
        data = self._process.stdout.read(1 << 16)
        if not data:
            self._reason = self._death()
            return []
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        return [json.loads(line) for line in lines]

    def _death(self) -> str:
        """Why the worker died, with its last words; nothing is left of it."""
        assert self._process is not None
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5.0)
        status = self._process.returncode
        words = ""
        if self._stderr is not None:
            size = self._stderr.seek(0, os.SEEK_END)
            self._stderr.seek(max(0, size - _LAST_WORDS))
            text = self._stderr.read().decode(errors="replace").strip()
            words = f": {text.splitlines()[-1][:200]}" if text else ""
        self.kill()
        if status is not None and status < 0:
            try:
                name = signal.Signals(-status).name
            except ValueError:
                name = f"signal {-status}"
            return f"its worker was killed by {name}{words}"
        return f"its worker ended with status {status}{words}"

    def kill(self) -> None:
        """Ends the worker at once, and removes what it had not finished."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            with suppress(subprocess.TimeoutExpired):  # inside a disk that does not answer
                process.wait(10.0)
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    with suppress(OSError):
                        pipe.close()
        if self._stderr is not None:
            self._stderr.close()
            self._stderr = None
        shutil.rmtree(self._workshop, ignore_errors=True)

    def close(self) -> None:
        """Ends an idle worker."""
        self.kill()
