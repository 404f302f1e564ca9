"""Which format a log is in: by its first bytes, and by its name where these are damaged."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from hiermap_cli.errors import InputError
from hiermap_cli.logs.bag_folder import METADATA, folder_files

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from hiermap_cli.logs.container import Container
    from hiermap_cli.logs.source import Source

TEXT, MCAP, DB3, BAG = "text", "MCAP", "rosbag2", "ROS 1 bag"
_MAGIC_MCAP = b"\x89MCAP0\r\n"
_MAGIC_DB3 = b"SQLite format 3\0"
_MAGIC_BAG = b"#ROSBAG V"
_MAGIC_GZIP = b"\x1f\x8b"
_SUFFIXES = {".mcap": MCAP, ".db3": DB3, ".bag": BAG, ".zstd": DB3}


def open_source(paths: Sequence[Path]) -> Source:
    """The recording in one file, in a folder, or in the parts given; each file is read once.

    Raises InputError where a path is missing, empty, or of no known format.
    """
    if not paths:
        raise InputError("no log given")
    losses: list[str] = []
    files: list[Path] = []
    for path in paths:
        files += _files(path, losses)
    files, twice = _distinct(files)
    formats = [_format(path) for path in files]
    if len(set(formats) - {MCAP, DB3}) > 1 or (TEXT in formats and set(formats) != {TEXT}):
        kinds = ", ".join(f"{p.name} is {f}" for p, f in zip(files, formats, strict=True))
        raise InputError(f"the files are no parts of one recording: {kinds}")
    is_text = formats[0] == TEXT
    source = _text_source(files) if is_text else _message_log(files, formats, losses)
    source.twice = tuple(twice)
    return source


def _distinct(files: list[Path]) -> tuple[list[Path], list[str]]:
    """The files without those that are there already or equal another byte by byte; and these.

    Raises InputError where a file cannot be read.
    """
    kept: dict[Path, Path] = {}
    twice = [
        f"{path.name} is given twice: it is read once"
        for path in files
        if kept.setdefault(path.resolve(), path) is not path
    ]
    by_size: dict[int, list[Path]] = {}
    for path in kept.values():
        try:
            if path.is_file():
                by_size.setdefault(path.stat().st_size, []).append(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    for alike in by_size.values():
        originals: dict[bytes, Path] = {}
        for path in alike if len(alike) > 1 else ():
            original = originals.setdefault(_digest(path), path)
            if original is not path:
                del kept[path.resolve()]
                names = path.name, original.name
                if names[0] == names[1]:
                    names = f"{path.parent.name}/{names[0]}", f"{original.parent.name}/{names[1]}"
                twice.append(f"{names[0]} is a copy of {names[1]}: it is read once")
    return list(kept.values()), twice


def _digest(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def _files(path: Path, losses: list[str]) -> list[Path]:
    try:
        if path.name == METADATA and path.is_file():
            path = path.parent
        if path.is_dir():
            files, faults = folder_files(path)
            losses += faults
            return files
        if not path.exists():
            raise InputError(f"{path}: no such file or folder")
        if path.is_file() and path.stat().st_size == 0:
            raise InputError(f"{path}: the file is empty")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    return [path]


def _format(path: Path) -> str:
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    for magic, found in ((_MAGIC_MCAP, MCAP), (_MAGIC_DB3, DB3), (_MAGIC_BAG, BAG)):
        if head.startswith(magic):
            return found
    if head.startswith(_MAGIC_GZIP):
        return TEXT
    return _SUFFIXES.get(path.suffix.lower(), TEXT)


def _message_log(files: list[Path], formats: list[str], losses: list[str]) -> Source:
    from hiermap_cli.logs.bag_file import BagFile
    from hiermap_cli.logs.message_log import MessageLog
    from hiermap_cli.logs.rosbag2 import open_files

    containers: list[Container]
    if formats[0] == BAG:
        containers = [BagFile(path) for path in files]
    else:
        containers, faults = open_files(files)
        losses = losses + faults
    name = DB3 if DB3 in formats else formats[0]
    return MessageLog(name, containers, losses)


def _text_source(paths: Sequence[Path]) -> Source:
    """A CARMEN or Wean log, by its first record."""
    from hiermap_cli.logs.carmen import KNOWN, SNIFF_LINES, CarmenLog
    from hiermap_cli.logs.textfile import text_lines
    from hiermap_cli.logs.wean import LASER, ODOMETRY, WeanLog

    for number, line in enumerate(text_lines(paths[0], [])):
        fields = line[:4096].split(None, 6)
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
