"""The folder that a command writes, whole or not at all.

Everything goes into a folder of a temporary name beside the wanted one, is flushed to the disk,
and is renamed in one step. A command that dies leaves at most a hidden folder behind (its name
begins with a dot and the wanted name), never half an output. Where an older result is replaced,
it is moved aside first and removed last, so that one of the two is on the disk at any moment.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from hiermap_cli.errors import HiermapError, OutputError, UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

RESULT_MARKS = ("model.json", "report.json")
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


def check_output(
    folder: Path,
    *,
    force: bool,
    marks: Sequence[str] = RESULT_MARKS,
    inputs: Sequence[Path] = (),
) -> None:
    """Whether `folder` may be written, asked before the work and not after it.

    With `force` an existing folder may be replaced if it is empty or holds one of the files
    named in `marks`, so that a slip of the hand does not remove somebody's own folder.

    Raises:
        UsageError: the folder exists and may not be replaced, holds one of `inputs`, or its
            parent cannot be written.
    """
    folder = Path(os.path.realpath(folder))
    if os.path.lexists(folder):
        if not force:
            raise UsageError(f"{folder}: exists already; --force replaces it")
        if not folder.is_dir():
            raise UsageError(f"{folder}: is a file, not a folder; choose another output folder")
        _check_replaceable(folder, marks, inputs)
    _check_writable(folder)


def _check_writable(folder: Path) -> None:
    """Whether the nearest folder above that exists takes new names; nothing is made."""
    above = next(parent for parent in folder.parents if os.path.lexists(parent))
    if not above.is_dir():
        raise UsageError(f"{folder}: cannot be written ({above} is a file)")
    if not os.access(above, os.W_OK | os.X_OK):
        raise UsageError(
            f"{folder}: cannot be written ({above} takes no new files); choose another -o"
        )


def _check_replaceable(folder: Path, marks: Sequence[str], inputs: Sequence[Path]) -> None:
    for path in inputs:
        if folder in (real := Path(os.path.realpath(path))).parents or real == folder:
            raise UsageError(f"{folder}: holds the input {path}; choose another output folder")
    if folder == Path.cwd() or folder in Path.cwd().parents:
        raise UsageError(f"{folder}: is the working folder; choose another output folder")
    try:
        names = sorted(path.name for path in folder.iterdir())
    except OSError as error:
        raise output_error(folder, error) from None
    if names and not set(names) & set(marks):
        raise UsageError(
            f"{folder}: holds {names[0]} and no {' or '.join(marks)}, so it is no earlier result; "
            "--force does not replace it: remove it or choose another output folder"
        )


@contextmanager
def output_folder(
    folder: Path,
    *,
    force: bool = False,
    marks: Sequence[str] = RESULT_MARKS,
    inputs: Sequence[Path] = (),
    workshop: Path | None = None,
) -> Iterator[Path]:
    """A new, empty folder to write into, which becomes `folder` when the block ends well.

    `workshop` is where it lies until then: a folder on the same disk, beside `folder` if None.

    Raises:
        UsageError: as `check_output`.
        OutputError: the disk is full or fails.
    """
    check_output(folder, force=force, marks=marks, inputs=inputs)
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
        _move_into_place(temporary, folder, force=force, workshop=workshop)
    except OSError as error:
        raise output_error(folder, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)  # gone already when all went well


def _new_folder(parent: Path, name: str) -> Path:
    """A new, hidden folder; `mkdir` and not `mkdtemp`, so that the umask decides."""
    parent.mkdir(parents=True, exist_ok=True)
    while True:
        temporary = parent / f".{name[:200]}.{secrets.token_hex(4)}"
        try:
            temporary.mkdir()
        except FileExistsError:
            continue
        return temporary


def _move_into_place(temporary: Path, folder: Path, *, force: bool, workshop: Path) -> None:
    if not os.path.lexists(folder):
        temporary.rename(folder)
        _flush_folder(folder.parent)
        return
    if not force:  # it came into being while we worked
        raise UsageError(f"{folder}: exists already; --force replaces it")
    aside = _new_folder(workshop, folder.name)
    folder.rename(aside)  # an empty folder gives way to a renamed one
    try:
        temporary.rename(folder)
    except BaseException:
        aside.rename(folder)
        raise
    _flush_folder(folder.parent)
    shutil.rmtree(aside, ignore_errors=True)


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


@contextmanager
def output_file(path: Path) -> Iterator[Path]:
    """A new path beside `path` to write, which replaces `path` when the block ends well.

    Raises:
        UsageError: the file cannot be written there.
        OutputError: the disk is full or fails.
    """
    path = Path(os.path.realpath(path))
    temporary = path.with_name(f".{path.name[:200]}.{secrets.token_hex(4)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
        _flush_folder(path.parent)
    except OSError as error:
        raise output_error(path, error) from error
    finally:
        with suppress(OSError):  # gone already when all went well, or never made
            temporary.unlink()


def output_error(path: Path, error: OSError) -> HiermapError:
    """The error of hiermap for what the system said when `path` was written."""
    reason = error.strerror or str(error)
    if error.errno in _FULL:
        return OutputError(f"{path}: cannot be written ({reason}); nothing was left there")
    return UsageError(f"{path}: cannot be written ({reason}); choose another place with -o")
