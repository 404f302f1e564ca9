"""The top-level records of an MCAP file, found one after the other, over damaged places.

The walk reads the heads of records and skips their bodies, so it is quick even on large files.
It needs no index, no footer and no closing magic: what an unclosed or cut file still has is
found. Behind a damaged place it looks for the next bytes that begin a chain of whole records.
"""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, NamedTuple

from mcap.opcode import Opcode

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import BinaryIO

MAGIC = b"\x89MCAP0\r\n"

_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, uncompressed size, crc, compression's length
_WINDOW = 1 << 20
_CHAIN = 3  # records that must follow each other before a place counts as found again
# A record's head: an opcode and a length below 2^32. Looked ahead, so that matches may overlap.
_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{4}\x00{4})", re.DOTALL)
_PRIVATE = 0x80  # opcodes from here on belong to whoever wrote the file
_SMALLEST = {
    Opcode.HEADER: 8, Opcode.FOOTER: 20, Opcode.SCHEMA: 14, Opcode.CHANNEL: 16,
    Opcode.MESSAGE: 22, Opcode.CHUNK: 40, Opcode.MESSAGE_INDEX: 6, Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT: 36, Opcode.ATTACHMENT_INDEX: 48, Opcode.STATISTICS: 46,
    Opcode.METADATA: 8, Opcode.METADATA_INDEX: 20, Opcode.SUMMARY_OFFSET: 17, Opcode.DATA_END: 4,
}  # fmt: skip


class Found(NamedTuple):
    """A record: its opcode, where its body begins and how long it is; `whole` unless cut off."""

    opcode: int
    at: int
    length: int
    whole: bool


class ChunkHead(NamedTuple):
    """What precedes a chunk's records."""

    start_ns: int
    end_ns: int
    size: int  # uncompressed
    crc: int
    compression: str
    at: int  # of the records
    length: int  # of the records as stored


def walk(file: BinaryIO, size: int, losses: list[str]) -> Iterator[Found]:
    """Every record that can be found, to the end of the file; damaged places go to `losses`."""
    file.seek(0)
    at = len(MAGIC)
    if file.read(at) != MAGIC:
        losses.append("the file does not begin as an MCAP does")
    closed = False
    last: Found | None = None
    while at < size:
        found = record_at(file, size, at)
        if found is not None and found.whole:
            yield found
            closed |= found.opcode == Opcode.FOOTER
            at = found.at + found.length
            last = found
            continue
        if _is_closing(file, size, at):
            break
        if found is not None and _honest_chunk(file, found):
            yield found
            losses.append(f"the file is cut off inside the chunk at byte {at}")
            return
        # It may be the length of the record before that is damaged, and leads astray.
        begin = at + 1 if last is None or _honest_chunk(file, last) else last.at
        behind = find_next(file, size, begin)
        if behind is None:
            losses.append(f"the file is cut off or damaged from byte {at} to its end, {size}")
            return
        losses.append(f"bytes {min(at, begin)} to {behind} are damaged")
        at, last = behind, None
    if not closed:
        losses.append("the file was not closed: it has no footer")


def _honest_chunk(file: BinaryIO, found: Found) -> bool:
    """Whether a chunk's head agrees with its record's length."""
    if found.opcode != Opcode.CHUNK:
        return False
    head = chunk_head(file, found)
    return head is not None and head.at + head.length == found.at + found.length


def _is_closing(file: BinaryIO, size: int, at: int) -> bool:
    file.seek(at)
    return size - at == len(MAGIC) and file.read(len(MAGIC)) == MAGIC


def record_at(file: BinaryIO, size: int, at: int) -> Found | None:
    """The record that begins at `at`; None where there is none. It may be cut off."""
    file.seek(at)
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    opcode, length = _HEAD.unpack(head)
    smallest = _SMALLEST.get(opcode, 0 if opcode >= _PRIVATE else None)
    if smallest is None or length < smallest or length >> 40:
        return None
    begin = at + _HEAD.size
    return Found(opcode, begin, length, begin + length <= size)


def plausible(file: BinaryIO, size: int, at: int) -> bool:
    """Whether a chain of whole records begins at `at`, or fewer of them to the file's end."""
    for number in range(_CHAIN):
        found = record_at(file, size, at)
        if found is None or not found.whole:
            return number > 0 and (at == size or _is_closing(file, size, at))
        if found.opcode == Opcode.CHUNK and not _honest_chunk(file, found):
            return False
        at = found.at + found.length
    return True


def find_next(file: BinaryIO, size: int, at: int) -> int | None:
    """Where the next chain of records begins, None where there is none to the file's end."""
    while at < size:
        file.seek(at)
        window = file.read(_WINDOW)
        for match in _CANDIDATE.finditer(window):
            if plausible(file, size, at + match.start()):
                return at + match.start()
        at += max(len(window) - _HEAD.size, 1)
    return None


def chunk_head(file: BinaryIO, found: Found) -> ChunkHead | None:
    """The head of a chunk record; None where it makes no sense."""
    file.seek(found.at)
    data = file.read(_CHUNK_HEAD.size + 16 + 8)
    try:
        start_ns, end_ns, size, crc, letters = _CHUNK_HEAD.unpack_from(data)
        if letters > 16:
            return None
        name = data[_CHUNK_HEAD.size : _CHUNK_HEAD.size + letters].decode("ascii")
        (length,) = struct.unpack_from("<Q", data, _CHUNK_HEAD.size + letters)
    except (struct.error, UnicodeDecodeError):
        return None
    at = found.at + _CHUNK_HEAD.size + letters + 8
    return ChunkHead(start_ns, end_ns, size, crc, name, at, length)
