"""Standard streams as the commands need them, however the program was started.

Cron jobs and service managers start programs with closed streams (`>&-`); a stream may also have
an encoding that lacks the letters of a file's name. Neither may cost a result.
"""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import TYPE_CHECKING

from hiermap_cli.errors import OutputError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_STREAMS = ("stdin", "stdout", "stderr")


class ClosedOutput(io.RawIOBase):
    """Stands for a stdout that was closed: whoever must print into it is told so."""

    def writable(self) -> bool:
        """Nothing is refused before it is written."""
        return True

    def write(self, data: ReadableBuffer, /) -> int:
        """Refuses what is not empty.

        Raises:
            OutputError: always, where there is something to print.
        """
        if memoryview(data).nbytes:
            raise OutputError(
                "stdout is closed, and there is something to print; send it to a file or to "
                "/dev/null instead"
            )
        return 0


def prepare_streams() -> None:
    """Gives each closed stream a stand-in, and each encoding a way to write every letter.

    Without this the files that are opened first would get the numbers of the closed streams, and
    what libraries print would go into them.
    """
    for descriptor, name in enumerate(_STREAMS):
        if getattr(sys, name) is None and not _is_open(descriptor):
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere != descriptor:
                os.dup2(nowhere, descriptor)
                os.close(nowhere)
            os.set_inheritable(descriptor, True)
    if sys.stdout is None:
        sys.stdout = io.TextIOWrapper(ClosedOutput(), encoding="utf-8", write_through=True)
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115 - to the end
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")


def _is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError as error:
        if error.errno != errno.EBADF:
            raise
        return False
    return True
