"""The jobs of a batch on a Dask cluster that is there already. An extra.

A task of the cluster does not run the job itself: it starts (or takes) a worker process of ours
on its machine and watches it, so that time and memory limits, and what a crash costs, are the
same as without a cluster. All machines see the batch's folder and the logs under the same paths.
When the batch dies, its lock on the folder becomes free: the tasks look at it and end.
"""

from __future__ import annotations

import os
import secrets
import socket
import threading
import time
from concurrent.futures import FIRST_COMPLETED, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiermap_cli import __version__
from hiermap_cli.batch.folder_lock import is_free
from hiermap_cli.batch.job import Job, Outcome, failed
from hiermap_cli.batch.worker_process import Stopped, WorkerProcess
from hiermap_cli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable
    from concurrent.futures import Executor, Future

EXTRA = "pip install 'hiermap[dask]'"
CONNECT_LIMIT = 10.0  # seconds
_AHEAD = 2  # tasks that the cluster holds for each of its threads: one at work, one waiting
_COUNT_EVERY = 10.0  # seconds between looks at how many threads the cluster has
_OWNER_EVERY = 1.0  # seconds between looks at whether the batch is alive
_IDLE = 30.0  # seconds after which a worker process that nobody wants ends


class DaskExecutor:
    """See `executors.Executor`.

    Args:
        address: of the scheduler, as in tcp://host:8786.
        folder: the batch's; workshops: a folder in it for what is not whole yet.
        lock: the file that the batch holds as long as it lives.
        warn: is told what a person should know.
    """

    def __init__(
        self,
        address: str,
        folder: Path,
        workshops: Path,
        lock: Path,
        warn: Callable[[str], None],
    ) -> None:
        self._address = address
        self._folder = folder.resolve()
        self._workshops = workshops.resolve()
        self._lock = lock.resolve()
        self._warn = warn

    def run(self, jobs: Iterable[Job]) -> Generator[Outcome, None, None]:
        """An outcome for every job, as they come.

        Raises:
            UsageError: no scheduler answers, or Dask is not installed.
        """
        client = _connected(self._address)
        try:
            yield from self._done(client, iter(jobs))
        finally:
            client.close()

    def _done(self, client: Any, waiting: Any) -> Generator[Outcome, None, None]:
        executor: Executor = client.get_executor(pure=False)
        at_work: dict[Future[dict[str, Any]], Job] = {}
        counted, threads = -_COUNT_EVERY, 0
        job = next(waiting, None)
        while job is not None or at_work:
            if time.monotonic() - counted > _COUNT_EVERY:
                threads = sum(client.nthreads().values())
                if not threads:
                    self._warn(f"{self._address}: the cluster has no workers; waiting for some")
                counted = time.monotonic()
            while job is not None and len(at_work) < max(1, _AHEAD * threads):
                at_work[executor.submit(do_isolated, *self._order(job))] = job
                job = next(waiting, None)
            done, _ = wait(at_work, timeout=_COUNT_EVERY, return_when=FIRST_COMPLETED)
            for future in done:
                yield _outcome(future, at_work.pop(future))

    def _order(self, job: Job) -> tuple[Any, ...]:
        places = (str(self._folder), str(self._workshops), str(self._lock))
        return (job.to_json(), *places, __version__)


def _connected(address: str) -> Any:
    """A client of the scheduler.

    Raises:
        UsageError: none answers, or Dask is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise UsageError(f"--scheduler needs Dask: {EXTRA}") from None
    try:
        client: Any = Client
        return client(address, timeout=CONNECT_LIMIT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UsageError(f"{address}: no Dask scheduler answers there ({reason})") from None


def _outcome(future: Future[dict[str, Any]], job: Job) -> Outcome:
    """What a task gave, or why the cluster has lost it."""
    try:
        return Outcome(**future.result())
    except Exception as error:  # noqa: BLE001 - whatever Dask or the network says, it costs one job
        reason = " ".join(str(error).split())[:200]
        return failed(job.name, f"the cluster lost it ({type(error).__name__}: {reason})")


# --- on the cluster's machines ---


def do_isolated(
    values: dict[str, Any], folder: str, workshops: str, lock: str, version: str
) -> dict[str, Any]:
    """One job in a process of its own, watched from a thread of a Dask worker."""
    job = Job.from_json(values)
    where = socket.gethostname()
    if version != __version__:
        reason = f"{where} has hiermap {__version__}, the batch {version}; install the same"
        return failed(job.name, reason)._asdict()
    if not Path(lock).exists():
        reason = f"{where} does not see the batch's folder {folder}; it must be a shared one"
        return failed(job.name, reason)._asdict()
    worker = _take(Path(folder), Path(workshops), Path(lock))
    try:
        outcome = worker.run(job, lambda _event: None)
    except Stopped:
        return failed(job.name, "the batch that wanted it has ended")._asdict()
    _put_back(worker, folder, lock)
    return outcome._asdict()


_IDLE_WORKERS: dict[tuple[str, str], list[tuple[WorkerProcess, threading.Timer]]] = {}
_IDLE_LOCK = threading.Lock()


def _take(folder: Path, workshops: Path, lock: Path) -> WorkerProcess:
    """A worker process that is idle on this machine, or a new one."""
    with _IDLE_LOCK:
        idle = _IDLE_WORKERS.get((str(folder), str(lock)))
        if idle:
            worker, timer = idle.pop()
            timer.cancel()
            return worker
    name = f"{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(4)}"
    return WorkerProcess(folder, workshops / name, should_stop=_OwnerDied(lock))


def _put_back(worker: WorkerProcess, folder: str, lock: str) -> None:
    """Keeps a worker for the next job, for a while."""
    key = folder, lock

    def retire() -> None:
        with _IDLE_LOCK:
            idle = _IDLE_WORKERS.get(key, [])
            kept = [entry for entry in idle if entry[0] is not worker]
            if len(kept) == len(idle):
                return  # taken in this instant
            _IDLE_WORKERS[key] = kept
        worker.close()

    timer = threading.Timer(_IDLE, retire)
    timer.daemon = True
    with _IDLE_LOCK:
        _IDLE_WORKERS.setdefault(key, []).append((worker, timer))
    timer.start()


class _OwnerDied:
    """Whether the batch that gave the jobs is gone, asked now and then."""

    def __init__(self, lock: Path) -> None:
        self._lock = lock
        self._asked = time.monotonic()

    def __call__(self) -> bool:
        now = time.monotonic()
        if now - self._asked < _OWNER_EVERY:
            return False
        self._asked = now
        return is_free(self._lock)
