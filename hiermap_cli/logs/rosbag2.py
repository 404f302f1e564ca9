"""rosbag2 recordings: a folder with metadata.yaml, or its files alone.

The folder's list of files says which belong to the recording, split or not, compressed or not.
Where metadata.yaml is missing or damaged, the files that lie there are the recording.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiermap_cli.errors import InputError
from hiermap_cli.logs.compression import unzstd_file
from hiermap_cli.logs.db3_file import Db3File
from hiermap_cli.logs.detect import METADATA
from hiermap_cli.logs.mcap_file import McapFile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiermap_cli.logs.container import Container

ENDINGS = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")


def is_bag_file(path: Path) -> bool:
    """By its name."""
    return path.name.endswith(ENDINGS)


def folder_files(folder: Path) -> tuple[list[Path], list[str]]:
    """The files of a recording's folder, and what is wrong with it.

    Raises InputError where no recording is in it.
    """
    losses: list[str] = []
    try:
        there = sorted(path for path in folder.iterdir() if is_bag_file(path))
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror or error}") from error
    listed = _listed(folder, losses)
    if listed:
        missing = [path.name for path in listed if not path.is_file()]
        if missing:
            losses.append(f"{folder.name}: {METADATA} lists {', '.join(missing)}: not there")
        files = [path for path in listed if path.is_file()]
        if files:
            return files, losses
    if not there:
        raise InputError(f"{folder}: no recording in this folder (no .db3 or .mcap file)")
    return there, losses


def _listed(folder: Path, losses: list[str]) -> list[Path]:
    """The files that metadata.yaml names, empty where it does not say."""
    import yaml

    path = folder / METADATA
    if not path.is_file():
        losses.append(f"{folder.resolve().name}: no {METADATA}: all files there are read")
        return []
    try:
        document: Any = yaml.safe_load(path.read_bytes())
        information = document["rosbag2_bagfile_information"]
        names = information.get("relative_file_paths") or [
            entry["path"] for entry in information["files"]
        ]
        # Early versions wrote the folder's own name before the files' names.
        listed = [folder / Path(str(name)).name for name in names]
    except (yaml.YAMLError, KeyError, TypeError, AttributeError, ValueError, OSError) as error:
        fault = str(error).splitlines()[0] if str(error) else type(error).__name__
        losses.append(f"{folder.name}: {METADATA} is damaged ({fault}): all files there are read")
        return []
    return [_as_stored(path) for path in listed]


def _as_stored(path: Path) -> Path:
    compressed = path.with_name(path.name + ".zstd")
    return compressed if not path.exists() and compressed.exists() else path


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
