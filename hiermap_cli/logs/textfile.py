"""Lines of plain or gzipped text files, read as far as they are intact."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import BinaryIO

GZIP_MAGIC = b"\x1f\x8b"
_READ_BYTES = 1 << 16
_RETRY_BYTES = 1 << 6
_LONGEST_LINE = 1 << 24  # bytes; a longer "line" is no text


def text_lines(path: Path, losses: list[str]) -> Iterator[bytes]:
    """The lines of a file without their ends; what a damaged file lost is added to `losses`.

    Raises InputError where the file cannot be opened or is no text at all.
    """
    try:
        with path.open("rb") as file:
            is_gzip = file.read(2) == GZIP_MAGIC
            file.seek(0)
            pieces = _gunzip(file, path, losses) if is_gzip else _plain(file)
            yield from _split(pieces, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def _plain(file: BinaryIO) -> Iterator[bytes]:
    while piece := file.read(_READ_BYTES):
        yield piece


def _split(pieces: Iterator[bytes], path: Path) -> Iterator[bytes]:
    rest = b""
    for piece in pieces:
        lines = (rest + piece).split(b"\n")
        rest = lines.pop()
        if len(rest) > _LONGEST_LINE:
            raise InputError(f"{path}: no line ends in {len(rest)} bytes: this is no text log")
        yield from lines
    if rest:
        yield rest


def _gunzip(file: BinaryIO, path: Path, losses: list[str]) -> Iterator[bytes]:
    """Decompressed pieces, up to the first byte that cannot be decompressed."""
    stream = zlib.decompressobj(wbits=31)
    open_member = False
    while data := file.read(_READ_BYTES):
        while data:
            before = stream.copy()
            try:
                piece = stream.decompress(data)
            except zlib.error as error:
                yield _until_fault(before, data)
                at = file.tell() - len(data)
                losses.append(f"{path.name}: gzip stream damaged after byte {at}: {error}")
                return
            yield piece
            data = stream.unused_data
            open_member = not stream.eof
            if stream.eof:
                stream = zlib.decompressobj(wbits=31)
                data = data.lstrip(b"\0")  # members may be padded with zeros
    if open_member:
        losses.append(f"{path.name}: gzip stream ends early: the file is cut off")


def _until_fault(stream: zlib._Decompress, data: bytes) -> bytes:
    """What `data` gives before the fault: zlib keeps nothing of a call that fails."""
    out = []
    for at in range(0, len(data), _RETRY_BYTES):
        try:
            out.append(stream.decompress(data[at : at + _RETRY_BYTES]))
        except zlib.error:
            break
    return b"".join(out)
