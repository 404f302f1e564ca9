"""The folder that a command writes, whole or not at all.

Everything goes into a folder of a temporary name beside the wanted one, is flushed to the disk,
and is renamed in one step. A command that dies leaves at most a hidden folder behind (its name
begins with a dot and the wanted name), never half an output. Where an older result is replaced,
it is moved aside first and removed last, so that one of the two is on the disk at any moment.
A folder is only replaced if hiermap has written everything in it.
"""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from hiermap_cli.documents.own_files import output_fault
from hiermap_cli.errors import UsageError, output_error

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from hiermap_cli.documents.own_files import Contents, Output


def check_output(
    folder: Path, contents: Contents, *, force: bool, inputs: Sequence[Path] = ()
) -> None:
    """Whether `folder` may be written, asked before the work and not after it.

    An empty folder may be used. With `force` one may be replaced that holds `contents` and
    nothing else, so that a slip of the hand does not remove somebody's own files.

    Raises:
        UsageError: the folder exists and may not be replaced, holds one of `inputs`, or its
            parent cannot be written.
    """
    folder = Path(os.path.realpath(folder))
    if os.path.lexists(folder):
        _check_existing(folder, contents, force=force, inputs=inputs)
    _check_writable(folder)


def _check_writable(folder: Path, option: str = "-o") -> None:
    """Whether the nearest folder above that exists takes new names; nothing is made."""
    above = next(parent for parent in folder.parents if os.path.lexists(parent))
    if not above.is_dir():
        raise UsageError(
            f"{folder}: cannot be written ({above} is a file); choose another place with {option}"
        )
    if not os.access(above, os.W_OK | os.X_OK):
        raise UsageError(
            f"{folder}: cannot be written ({above} takes no new files); "
            f"choose another place with {option}"
        )


def _check_existing(
    folder: Path, contents: Contents, *, force: bool, inputs: Sequence[Path]
) -> None:
    """Whether what is there may give way. What --force would not help against is said first."""
    if not folder.is_dir():
        raise UsageError(f"{folder}: is a file, not a folder; choose another output folder")
    for path in inputs:
        if folder in (real := Path(os.path.realpath(path))).parents or real == folder:
            raise UsageError(f"{folder}: holds the input {path}; choose another output folder")
    here = Path.cwd()
    if folder == here or folder in here.parents:
        raise UsageError(
            f"{folder}: is the working folder or one above it; choose another output folder"
        )
    if os.path.ismount(folder):
        raise UsageError(f"{folder}: is a mount point; choose a folder in it")
    _check_contents(folder, folder, contents, force=force)


def _check_contents(folder: Path, shown: Path, contents: Contents, *, force: bool) -> None:
    try:
        if not any(folder.iterdir()):
            return
        fault = contents.fault(folder)
    except OSError as error:
        raise output_error(shown, error) from None
    if fault is not None:
        raise UsageError(
            f"{shown}: {fault} and is never replaced: "
            "move it elsewhere or choose another output folder"
        )
    if not force:
        raise UsageError(f"{shown}: exists already; --force replaces it")


@contextmanager
def output_folder(
    folder: Path,
    contents: Contents,
    *,
    force: bool = False,
    inputs: Sequence[Path] = (),
    workshop: Path | None = None,
) -> Iterator[Path]:
    """A new, empty folder to write into, which becomes `folder` when the block ends well.

    `contents` is what an earlier one holds that `force` may replace, see `check_output`.
    `workshop` is where it lies until then: a folder on the same disk, beside `folder` if None.

    Raises:
        UsageError: as `check_output`.
        OutputError: the disk is full or fails.
    """
    check_output(folder, contents, force=force, inputs=inputs)
    folder = Path(os.path.realpath(folder))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        workshop = folder.parent if workshop is None else Path(os.path.realpath(workshop))
        temporary = _new_folder(workshop, folder.name)
    except OSError as error:
        raise output_error(folder, error) from None
    try:
        yield temporary
        _flush(temporary)
        _move_into_place(temporary, folder, contents, force=force, workshop=workshop)
    except OSError as error:
        raise output_error(folder, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)  # gone already when all went well


def _new_folder(parent: Path, name: str) -> Path:
    """A new, hidden folder; `mkdir` and not `mkdtemp`, so that the umask decides."""
    parent.mkdir(parents=True, exist_ok=True)
    while True:
        temporary = parent / f".{name[:200]}.{os.urandom(4).hex()}"
        try:
            temporary.mkdir()
        except FileExistsError:
            continue
        return temporary


def _move_into_place(
    temporary: Path, folder: Path, contents: Contents, *, force: bool, workshop: Path
) -> None:
    if not os.path.lexists(folder) or _is_empty(folder):
        temporary.rename(folder)  # the system refuses if it is not empty any more
        _flush_folder(folder.parent)
        return
    # Asked again: something may have come into being while we worked.
    _check_existing(folder, contents, force=force, inputs=())
    aside = _new_folder(workshop, folder.name)
    folder.rename(aside)  # an empty folder gives way to a renamed one
    try:
        _check_contents(aside, folder, contents, force=force)  # where nobody writes any more
        temporary.rename(folder)
    except BaseException:
        aside.rename(folder)
        raise
    _flush_folder(folder.parent)
    shutil.rmtree(aside, ignore_errors=True)


def _is_empty(folder: Path) -> bool:
    return folder.is_dir() and not any(folder.iterdir())


def _flush(folder: Path) -> None:
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
        else:
            _flush_folder(path)
    _flush_folder(folder)


def _flush_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def check_files(outputs: Iterable[Output], inputs: Iterable[Path]) -> None:
    """Whether files may be written, asked before the work and not after it.

    Raises:
        UsageError: one is an input, another of them, no file of hiermap, or cannot be written.
    """
    outputs = list(outputs)
    if (fault := output_fault(outputs, inputs)) is not None:
        raise UsageError(fault)
    for output in outputs:
        _check_writable(Path(os.path.realpath(output.path)), output.option)


@contextmanager
def output_file(path: Path, option: str = "-o") -> Iterator[Path]:
    """A new path beside `path` to write, which replaces `path` when the block ends well.

    `option` is the one by which a person can choose another.

    Raises:
        UsageError: the file cannot be written there.
        OutputError: the disk is full or fails.
    """
    path = Path(os.path.realpath(path))
    temporary = path.with_name(f".{path.name[:200]}.{os.urandom(4).hex()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
        _flush_folder(path.parent)
    except OSError as error:
        raise output_error(path, error, option) from error
    finally:
        with suppress(OSError):  # gone already when all went well, or never made
            temporary.unlink()
