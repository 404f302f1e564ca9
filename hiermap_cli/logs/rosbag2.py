"""The files of rosbag2 recordings, compressed or not: one of several may be damaged."""

from __future__ import annotations

import os
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from hiermap_cli.errors import InputError
from hiermap_cli.logs.compression import unzstd_file
from hiermap_cli.logs.db3_file import Db3File
from hiermap_cli.logs.mcap_file import McapFile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiermap_cli.logs.container import Container


def open_files(paths: Sequence[Path]) -> tuple[list[Container], list[str]]:
    """The files of a recording, and what could not be read at all.

    Raises InputError where none of them can be read.
    """
    containers: list[Container] = []
    losses: list[str] = []
    fault: InputError | None = None
    for path in paths:
        try:
            containers.append(_open_file(path))
        except InputError as error:
            losses.append(str(error))
            fault = fault or error
    if not containers:
        raise fault or InputError("no files of a recording")
    return containers, losses


def _open_file(path: Path) -> Container:
    losses: list[str] = []
    stored = path
    if path.suffix == ".zstd":
        stored = _decompressed(path, losses)
    try:
        container: Container = (
            Db3File(stored, path) if stored.suffix == ".db3" else McapFile(stored, path)
        )
    except InputError as error:
        if stored is not path:
            _remove(str(stored))
        raise InputError("; ".join([str(error), *losses])) from error
    if stored is not path:
        weakref.finalize(container, _remove, str(stored))
    container.losses[:0] = losses
    return container


def _decompressed(path: Path, losses: list[str]) -> Path:
    """A temporary file with the decompressed content."""
    ending = Path(path.stem).suffix
    try:
        number, name = tempfile.mkstemp(prefix="hiermap-", suffix=ending)
        os.close(number)
        unzstd_file(path, Path(name), losses)
    except OSError as error:
        raise InputError(f"{path}: cannot be decompressed: {error.strerror or error}") from error
    return Path(name)


def _remove(name: str) -> None:
    with suppress(OSError):
        Path(name).unlink()
