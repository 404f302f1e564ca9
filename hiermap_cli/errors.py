"""The one family of errors that hiermap raises on purpose, and its exit statuses.

Every error carries what a person needs in one line: what is wrong, where, and what to do.
The command line catches `HiermapError` at one boundary; anything else is a fault of the
program and keeps its traceback.
"""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

EXIT_OK = 0
EXIT_INPUT = 1
EXIT_USAGE = 2
EXIT_LIMIT = 3
EXIT_FAULT = 70
EXIT_INTERRUPTED = 130


class HiermapError(Exception):
    """Base of all expected errors; `exit_status` is the status of the process that ends by it."""

    exit_status: int = EXIT_FAULT


class InputError(HiermapError):
    """The input cannot be used: unreadable, damaged beyond use, no scans, no odometry."""

    exit_status = EXIT_INPUT


class OutputError(HiermapError):
    """The results cannot be written: the disk is full or fails. Nothing half-written is left."""

    exit_status = EXIT_INPUT


class UsageError(HiermapError):
    """Wrong usage of the program, such as an output folder that already exists."""

    exit_status = EXIT_USAGE


class ConfigurationError(UsageError):
    """One or more faults in a configuration; `faults` lists each with its path."""

    def __init__(self, source: str, faults: list[str]) -> None:
        self.source = source
        self.faults = list(faults)
        super().__init__(f"{source}: " + "; ".join(faults))


_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


def output_error(path: Path, error: OSError, option: str = "-o") -> HiermapError:
    """The error of hiermap for what the system said when `path` was written.

    `option` is the one by which a person can choose another place.
    """
    reason = error.strerror or str(error)
    if error.errno in _FULL:
        return OutputError(f"{path}: cannot be written ({reason}); nothing was left there")
    return UsageError(f"{path}: cannot be written ({reason}); choose another place with {option}")
