"""Any log that can be read, written as a ROS 2 MCAP: the body of `hiermap convert`.

What is written is what `run` would read: scans of the chosen topic with their ranges translated,
the chosen odometry, both by their settled times, and the mount. What `run` then reads is the
same to the last bit.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.errors import UsageError
from hiermap_cli.logs.join import plausible, sound_geometry
from hiermap_cli.logs.mcap_walk import MAGIC
from hiermap_cli.logs.mcap_writer import WRITER, RosMcapWriter
from hiermap_cli.logs.records import Odometry

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from hiermap_cli.logs.recording import InputReport, Recording

ENDING = ".mcap"

_FOREIGN = "hiermap did not write it and never replaces it: choose another name"
_HEAD = 1024  # bytes of an MCAP that hold the beginning of its header
_EVERY = 256  # scans between reports of progress


class Converted(NamedTuple):
    """What was written."""

    scans: int
    odometry: int
    report: InputReport


def check_target(target: Path, *, overwrite: bool) -> None:
    """Whether `target` may be written, asked before the work. Raises UsageError."""
    if target.suffix.lower() != ENDING and not os.path.isdir(target):  # noqa: PTH112
        raise UsageError(f"{target}: not written; an MCAP wants a name that ends in {ENDING}")
    if not os.path.isdir(target.parent):  # noqa: PTH112 - raises nothing
        raise UsageError(f"{target}: there is no folder {target.parent}")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise UsageError(
            f"{target}: cannot be written ({target.parent} takes no new files); "
            "choose another place with -o"
        )
    if target.is_dir():
        raise UsageError(f"{target}: is a folder; name a file")
    if target.exists() and not target.is_file():
        raise UsageError(f"{target}: is no regular file; choose another name")
    if target.exists() and not overwrite:
        # What --force would not help against is said first.
        way_out = "--force replaces it" if _is_ours(target) else _FOREIGN
        raise UsageError(f"{target}: exists already; {way_out}")


def _is_ours(path: Path) -> bool:
    """Whether a file is empty, or an MCAP whose header names this program as its writer."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return False
    # After the magic the header's opcode and length, then two strings: the profile, the writer.
    at = len(MAGIC) + 1 + 8
    if not head.startswith(MAGIC) or len(head) < at + 8:
        return not head
    at += 4 + int.from_bytes(head[at : at + 4], "little")
    return head[at + 4 :].startswith(f"{WRITER} ".encode())


def convert(
    recording: Recording,
    target: Path,
    *,
    overwrite: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Converted:
    """Writes the recording to `target`, whole or not at all.

    Raises:
        InputError: the log has no scans, or stamps that do not fit into ROS messages.
        UsageError: `target` exists and may not be replaced, is one of the log's own files, or
            cannot be written.
        OutputError: the disk is full or fails.
    """
    real = target.resolve()
    if any(path.resolve() == real for path in recording.source.paths):
        raise UsageError(f"{target}: is the log itself; choose another name")
    if target.exists() and not _is_ours(target):
        raise UsageError(f"{target}: {_FOREIGN}")
    scans = odometry = 0
    laser = recording.plan.first_laser
    with RosMcapWriter(target, recording.mount, overwrite=overwrite) as writer:
        for timed in recording.ordered():
            value = timed.value
            if isinstance(value, Odometry):
                if plausible(value):
                    pose = (value.x, value.y, value.theta)
                    writer.odometry(timed.time_ns, pose)
                    odometry += 1
                continue
            if sound_geometry(value.laser):
                laser, ranges = value.laser, value.ranges
            else:  # one that says nothing, as `run` takes it
                ranges = np.full(laser.beams, np.nan, dtype=np.float32)
            writer.scan(timed.time_ns, ranges, laser)
            scans += 1
            if progress is not None and scans % _EVERY == 0:
                progress(_EVERY)
        recording.check(scans)
    return Converted(scans, odometry, recording.report())
