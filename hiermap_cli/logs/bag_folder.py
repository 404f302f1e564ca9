"""The folder of a rosbag2 recording: which of the files in it belong to it.

Its metadata.yaml says so, be they split or not, compressed or not. Where that is missing or
damaged, the files that lie there are the recording.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hiermap_cli.errors import InputError

METADATA = "metadata.yaml"
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
