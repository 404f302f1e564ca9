"""One batch at a time in a folder; the shards of one batch together.

The lock is the system's (flock): it ends with its owner, however that dies. The workers inherit
it, so that it is free only when nobody is left who may write.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hiermap_cli.errors import UsageError, output_error

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

WHOLE = ".lock"
PATIENCE = 3.0  # seconds: the workers of a batch that was killed die within one
_AGAIN = 0.05


@dataclass(frozen=True, slots=True)
class Shard:
    """The i-th of n parts of a batch, i from 1; of a batch that is not shared out, 1 of 1."""

    index: int = 1
    count: int = 1

    @property
    def is_whole(self) -> bool:
        """Whether it is all of the batch."""
        return self.count == 1

    @property
    def label(self) -> str:
        """As file names carry it: `2-of-8`."""
        return f"{self.index}-of-{self.count}"


def parse_shard(text: str) -> Shard:
    """The shard in a text such as `2/8`.

    Raises:
        ValueError: it is no i/n with 1 <= i <= n.
    """
    found = re.fullmatch(r"\s*([0-9]+)\s*/\s*([0-9]+)\s*", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise ValueError(f"{text!r} is no i/n with i from 1 to n, as in 2/8")
    return Shard(int(found[1]), int(found[2]))


@contextmanager
def lock_folder(folder: Path, shard: Shard) -> Iterator[tuple[int, ...]]:
    """Holds the folder for a batch, or for one shard of it; gives the descriptors to hand on.

    Raises:
        UsageError: another batch works there, or the folder cannot be written.
    """
    with ExitStack() as stack:
        if os.path.lexists(folder) and not folder.is_dir():
            raise UsageError(f"{folder}: is a file, not a folder; choose another output folder")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            handles = _held(stack, folder, shard)
        except OSError as error:
            raise output_error(folder, error) from None
        yield handles


def _held(stack: ExitStack, folder: Path, shard: Shard) -> tuple[int, ...]:
    deadline = time.monotonic() + PATIENCE
    whole = stack.enter_context(_open(folder / WHOLE))
    if shard.is_whole:
        _hold(whole, fcntl.LOCK_EX, deadline, folder)
        return (whole,)
    _hold(whole, fcntl.LOCK_SH, deadline, folder)
    mine = stack.enter_context(_open(folder / f"{WHOLE}-of-{shard.count}"))
    _hold(mine, fcntl.LOCK_SH, deadline, folder)
    for path in folder.glob(f"{WHOLE}-of-*"):
        if path.name != f"{WHOLE}-of-{shard.count}":
            # Shards of another count have other shares: a job would be in two of them.
            with _open(path) as other:
                _hold(other, fcntl.LOCK_EX, deadline, folder)
    own = stack.enter_context(_open(lock_path(folder, shard)))
    _hold(own, fcntl.LOCK_EX, deadline, folder, f"shard {shard.index}/{shard.count} of the ")
    return (whole, mine, own)


def lock_path(folder: Path, shard: Shard) -> Path:
    """The file that a batch, or a shard of it, holds for itself alone."""
    return folder / (WHOLE if shard.is_whole else f"{WHOLE}-{shard.label}")


def is_free(path: Path) -> bool:
    """Whether the owner of a lock has died, or the lock is gone; for those far from it."""
    try:
        with _open(path, os.O_RDWR) as handle:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


@contextmanager
def summary_lock(folder: Path) -> Iterator[None]:
    """Holds the reports of a folder while they are put together; waits for its turn.

    Raises:
        OSError: the folder cannot be written.
    """
    with _open(folder / f"{WHOLE}-summary") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextmanager
def _open(path: Path, flags: int = os.O_RDWR | os.O_CREAT) -> Iterator[int]:
    handle = os.open(path, flags, 0o666)
    try:
        yield handle
    finally:
        os.close(handle)


def _hold(handle: int, kind: int, deadline: float, folder: Path, what: str = "") -> None:
    while True:
        try:
            fcntl.flock(handle, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                raise UsageError(
                    f"{folder}: {what or 'another '}batch is at work there; "
                    "wait for it, or choose another -o"
                ) from None
            time.sleep(_AGAIN)
        else:
            return
