"""Who does the jobs: workers on this machine. The seam that a Dask cluster stands behind too."""

from __future__ import annotations

import os
import queue
import threading
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Protocol

from hiermap_cli.batch.worker_process import Stopped, WorkerProcess

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable
    from pathlib import Path

    from hiermap_cli.batch.job import Job, Outcome
    from hiermap_cli.batch.worker_process import Event


class Executor(Protocol):
    """Does jobs, in whatever order, each in a process that can harm no other."""

    def run(self, jobs: Iterable[Job]) -> Generator[Outcome, None, None]:
        """An outcome for every job, as they come; jobs are asked for when there is room.

        When the caller stops asking, or is interrupted, nothing goes on working.
        """
        ...


def usable_processors() -> int:
    """How many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class LocalExecutor:
    """Worker processes on this machine, each with a thread here that watches it.

    Args:
        folder: the batch's.
        workshops: a folder on the same disk; each worker gets one of its own in it.
        workers: how many.
        keep_open: file descriptors that the workers inherit.
        tell: is told from any thread what a worker (by number) says of its job.
        watched: somebody looks on, and wants to know how many scans a log has.
    """

    def __init__(
        self,
        folder: Path,
        workshops: Path,
        workers: int,
        *,
        keep_open: tuple[int, ...] = (),
        tell: Callable[[int, Job, Event], None] = lambda _worker, _job, _event: None,
        watched: bool = False,
    ) -> None:
        self._folder = folder
        self._workshops = workshops
        self._count = workers
        self._keep_open = keep_open
        self._tell = tell
        self._watched = watched

    def run(self, jobs: Iterable[Job]) -> Generator[Outcome, None, None]:
        """See `Executor`."""
        shared = _Shared(jobs)
        threads = [
            threading.Thread(target=self._work, args=(number, shared))
            for number in range(self._count)
        ]
        for thread in threads:
            thread.start()
        try:
            running = len(threads)
            while running:
                outcome = shared.done.get()
                if outcome is None:
                    running -= 1
                elif isinstance(outcome, BaseException):
                    raise outcome
                else:
                    yield outcome
        finally:
            shared.stop.set()
            for thread in threads:
                thread.join()

    def _work(self, number: int, shared: _Shared) -> None:
        """The thread of one worker."""
        worker = WorkerProcess(
            self._folder,
            self._workshops / str(number),
            keep_open=self._keep_open,
            watched=self._watched,
            should_stop=shared.stop.is_set,
        )
        try:
            with suppress(Stopped):
                while (job := shared.take()) is not None:
                    shared.done.put(worker.run(job, partial(self._tell, number, job)))
        except BaseException as error:  # noqa: BLE001 - raised where the outcomes are read
            shared.done.put(error)
        finally:
            worker.close()
            shared.done.put(None)


class _Shared:
    """What the threads of workers share: the jobs that wait, the outcomes, and the end."""

    def __init__(self, jobs: Iterable[Job]) -> None:
        self._waiting = iter(jobs)
        self._taking = threading.Lock()
        self.stop = threading.Event()
        self.done: queue.SimpleQueue[Outcome | BaseException | None] = queue.SimpleQueue()

    def take(self) -> Job | None:
        """The next job; None where there is none or the batch is being stopped."""
        with self._taking:
            return None if self.stop.is_set() else next(self._waiting, None)
