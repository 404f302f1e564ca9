"""How much memory a worker holds, how much it held at most in a job, and a hard stop.

The limit of a job is on its resident memory, which is what a machine, a container or a batch
system counts. The limits that the system itself offers count something else: RLIMIT_AS counts
addresses, of which numpy, BLAS and mapped files reserve hundreds of megabytes that are never
touched, and RLIMIT_RSS has no effect. So resident memory is watched from outside, and a worker
above its limit is killed. A single request that is far too large is refused at once by
RLIMIT_DATA (private writable memory, touched or not), set to twice the limit above what the idle
worker has: room for arrays that are reserved and not filled, and an end to what outruns the watch.
"""

from __future__ import annotations

import ctypes
import gc
import re
import resource
import sys
from contextlib import suppress
from pathlib import Path

_SLACK = 2  # RLIMIT_DATA against the limit on resident memory
_PAGE = resource.getpagesize()


def can_watch() -> bool:
    """Whether this system tells how much memory another process holds."""
    return Path("/proc/self/statm").exists()


def resident_bytes(pid: int) -> int | None:
    """Resident memory of a process; None where the system does not tell, or it is gone."""
    try:
        with open(f"/proc/{pid}/statm", "rb") as file:  # noqa: PTH123 - often
            return int(file.read().split()[1]) * _PAGE
    except (OSError, IndexError, ValueError):
        return None


def settle_in() -> None:
    """Once, when a worker has loaded what it needs: none of that is looked at for garbage again.

    A full collection over all modules takes some 50 ms, and one is due before every job.
    """
    gc.collect()
    gc.freeze()


def begin_job(limit: int | None) -> None:
    """Makes a warm worker like a fresh one, and sets its hard stop.

    What an earlier job has freed goes back to the system, and its peak is forgotten.
    """
    set_hard_stop(None)
    gc.collect()
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library than glibc
            ctypes.CDLL(None).malloc_trim(0)
        with suppress(OSError):  # a container may forbid it: the peak is then that of all jobs
            Path("/proc/self/clear_refs").write_text("5")
    set_hard_stop(limit)


def peak_bytes() -> int | None:
    """The most resident memory since `begin_job`; None where the system does not tell."""
    kilobytes = _status("VmHWM")
    return kilobytes * 1024 if kilobytes is not None else None


def set_hard_stop(limit: int | None) -> None:
    """RLIMIT_DATA so far above the present use; without a limit, what it was at first."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    soft = hard
    present = _status("VmData")
    if limit is not None and present is not None:
        soft = present * 1024 + _SLACK * limit
        if hard != resource.RLIM_INFINITY:
            soft = min(soft, hard)
    with suppress(ValueError, OSError):  # not on this system: the watch alone holds the limit
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _status(name: str) -> int | None:
    """A line of /proc/self/status, in kilobytes."""
    try:
        text = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return None
    found = re.search(rf"^{name}:\s+(\d+) kB", text, re.MULTILINE)
    return int(found[1]) if found else None
