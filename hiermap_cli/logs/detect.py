"""Which format a log is in, by its first bytes; its name helps only where these are damaged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiermap_cli.errors import InputError
from hiermap_cli.logs.carmen import KNOWN, SNIFF_LINES, CarmenLog
from hiermap_cli.logs.textfile import text_lines
from hiermap_cli.logs.wean import LASER, ODOMETRY, WeanLog

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from hiermap_cli.logs.source import Source


def open_source(paths: Sequence[Path]) -> Source:
    """The recording in one file, in a folder, or in the parts given.

    Raises InputError where a path is missing, empty, or of no known format.
    """
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: no such file or folder")
        if path.is_file() and path.stat().st_size == 0:
            raise InputError(f"{path}: the file is empty")
    if all(path.suffix == ".mcap" for path in paths):
        from hiermap_cli.logs.mcap_file import McapFile
        from hiermap_cli.logs.message_log import MessageLog

        return MessageLog("MCAP", [McapFile(path) for path in paths])
    return text_source(paths)


def text_source(paths: Sequence[Path]) -> Source:
    """A CARMEN or Wean log, by its first record."""
    for number, line in enumerate(text_lines(paths[0], [])):
        fields = line.split(None, 6)
        name = fields[0] if fields else b"#"
        if name in KNOWN:
            return CarmenLog(paths)
        if name in (LASER.encode(), ODOMETRY.encode()) and len(fields) >= 5:
            return WeanLog(paths)
        if number > SNIFF_LINES:
            break
    raise InputError(
        f"{paths[0]}: not a log that hiermap reads (MCAP, rosbag2, ROS 1 bag, CARMEN, Wean)"
    )
