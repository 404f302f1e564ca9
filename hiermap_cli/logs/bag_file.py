"""ROS 1 bags (version 2.0), read chunk by chunk without need of their index.

A bag is a row of records, each a header of `name=value` fields and data. Messages lie in
chunks; behind each chunk are its index records, and behind all chunks the connections once more
and the chunk infos. An unindexed or cut bag lacks the end, and is read all the same.
"""

from __future__ import annotations

import struct
from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.errors import InputError
from hiermap_cli.logs.compression import DECOMPRESS_ERRORS, decompress
from hiermap_cli.logs.container import Channel, Message, Piece, in_log_order

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from typing import BinaryIO

MAGIC = b"#ROSBAG V2.0\n"
_MAGIC_OLD = b"#ROSBAG V1"

_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_OPS = (_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION)
_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")
_INDEX_ENTRY = 12  # time and offset
_LONGEST_HEADER = 1 << 16
_SECOND = 1_000_000_000

_FAULTS: tuple[type[BaseException], ...] = (struct.error, ValueError, KeyError, IndexError)

Fields = dict[bytes, bytes]


class _Chunk(NamedTuple):
    at: int
    length: int
    compression: str
    size: int
    begin_ns: int
    end_ns: int
    messages: int | None
    whole: bool
    connections: frozenset[int] | None  # in it, by its index; None where it has none


class BagFile:
    """One ROS 1 bag. Raises InputError where it cannot be opened or nothing is in it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses: list[str] = []
        self._connections: dict[int, Channel] = {}
        self._counts: Counter[int] = Counter()
        self._counted = True
        self._chunks: list[_Chunk] = []
        try:
            self._size = path.stat().st_size
            with path.open("rb") as file:
                self._survey(file)
                if not self._counted:  # then the connections too are told by the chunks alone
                    for chunk in self._chunks:
                        self._loader(file, chunk, lambda _: False, [])()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
        self.losses = [f"{path.name}: {loss}" for loss in self.losses]
        if not self._chunks:
            reason = f" ({self.losses[0]})" if self.losses else ""
            raise InputError(f"{path}: no messages in it{reason}")

    def channels(self) -> dict[Channel, int | None]:
        """Connections; one topic may have several, of as many publishers."""
        out: dict[Channel, int | None] = {}
        for number in sorted(self._connections):
            channel = self._connections[number]
            count = (out.get(channel) or 0) + self._counts[number]
            out[channel] = count if self._counted else None
        return out

    def span(self) -> tuple[int, int]:
        """By the index records behind the chunks."""
        begins = [chunk.begin_ns for chunk in self._chunks if chunk.end_ns]
        return (min(begins), max(c.end_ns for c in self._chunks)) if begins else (0, 0)

    def messages(
        self, wanted: Callable[[str], bool], losses: list[str], *, by_index: bool = False
    ) -> Iterator[Message]:
        """Messages of the wanted topics by log time."""
        try:
            with self.path.open("rb") as file:
                pieces = [
                    Piece(c.begin_ns, c.end_ns, self._loader(file, c, wanted, losses))
                    for c in self._chunks
                    if not by_index or self._may_hold(c, wanted)
                ]
                yield from in_log_order(pieces)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error}") from error

    def _may_hold(self, chunk: _Chunk, wanted: Callable[[str], bool]) -> bool:
        """Whether a chunk may hold a wanted topic: without an index, any may."""
        if chunk.connections is None or not chunk.connections <= self._connections.keys():
            return True
        return any(wanted(self._connections[number].topic) for number in chunk.connections)

    def _survey(self, file: BinaryIO) -> None:
        """Finds the chunks, the connections and what the index says of them."""
        magic = file.read(len(MAGIC))
        if magic.startswith(_MAGIC_OLD):
            version = magic[9:].split(b"\n")[0].decode("ascii", "replace")
            raise InputError(
                f"{self.path}: a bag of version {version}; `rosbag fix` brings it to 2.0"
            )
        at = len(MAGIC)
        indexed = False
        while at < self._size:
            found = _record_head(file, self._size, at)
            if found is None:
                behind = _find_chunk(file, self._size, at + 1)
                if behind is None:
                    self.losses.append(f"cut off or damaged from byte {at} on (of {self._size})")
                    break
                self.losses.append(f"bytes {at} to {behind} are damaged")
                at = behind
                continue
            op, fields, begin, length = found
            try:
                self._note(file, op, fields, begin, length)
            except _FAULTS as error:
                self.losses.append(f"record at byte {at} is damaged: {error}")
            if begin + length > self._size:
                self.losses.append(f"cut off inside the record at byte {at}")
                break
            indexed |= op == _CHUNK_INFO
            at = begin + length
        if not indexed:
            self.losses.append("the bag was not closed: it has no index")
            self._counted = False

    def _note(self, file: BinaryIO, op: int, fields: Fields, at: int, length: int) -> None:
        whole = at + length <= self._size
        if op == _CHUNK:
            self._note_chunk(fields, at, length, whole)
        elif op == _INDEX and whole:
            self._note_index(file, fields, at, length)
        elif op == _CONNECTION and whole:
            file.seek(at)
            self._note_connection(fields, file.read(length))

    def _note_chunk(self, fields: Fields, at: int, length: int, whole: bool) -> None:
        compression = fields[b"compression"].decode("ascii")
        (size,) = _LENGTH.unpack(fields[b"size"])
        length = min(length, self._size - at)
        self._chunks.append(_Chunk(at, length, compression, size, 0, 0, None, whole, None))

    def _note_index(self, file: BinaryIO, fields: Fields, at: int, length: int) -> None:
        """The times and the number of messages of one connection in the chunk before it."""
        if not self._chunks:
            return
        (connection,) = _LENGTH.unpack(fields[b"conn"])
        file.seek(at)
        data = file.read(length)
        times = [
            _nanoseconds(data, entry) for entry in range(0, length - _INDEX_ENTRY + 1, _INDEX_ENTRY)
        ]
        if times:
            self._counts[connection] += len(times)
            chunk = self._chunks[-1]
            begin = min(times) if chunk.end_ns == 0 else min(chunk.begin_ns, *times)
            self._chunks[-1] = chunk._replace(
                begin_ns=begin,
                end_ns=max(chunk.end_ns, *times),
                messages=(chunk.messages or 0) + len(times),
                connections=(chunk.connections or frozenset()) | {connection},
            )

    def _note_connection(self, fields: Fields, data: bytes) -> None:
        (number,) = _LENGTH.unpack(fields[b"conn"])
        about = _fields(data)
        topic = fields.get(b"topic", about.get(b"topic", b"")).decode()
        self._connections[number] = Channel(topic, about[b"type"].decode(), "ros1")

    def _loader(
        self, file: BinaryIO, chunk: _Chunk, wanted: Callable[[str], bool], losses: list[str]
    ) -> Callable[[], list[Message]]:
        def load() -> list[Message]:
            file.seek(chunk.at)
            try:
                stored = file.read(chunk.length)
                cut_off = not chunk.whole
                data = decompress(chunk.compression, stored, chunk.size, cut_off=cut_off)
            except DECOMPRESS_ERRORS as error:
                many = "an unknown number of" if chunk.messages is None else chunk.messages
                losses.append(
                    f"{self.path.name}: chunk at byte {chunk.at} is damaged: "
                    f"{many} messages lost: {error}"
                )
                self._counted = False
                return []
            out: list[Message] = []
            try:
                self._parse(data, wanted, out)
            except _FAULTS as error:
                if chunk.whole:
                    at = f"{self.path.name}: chunk at byte {chunk.at} is damaged"
                    losses.append(f"{at}: read up to message {len(out)}: {error}")
            return out

        return load

    def _parse(self, data: bytes, wanted: Callable[[str], bool], out: list[Message]) -> None:
        """Messages among the records of a chunk into `out`; connections are kept."""
        at = 0
        chosen: dict[int, Channel | None] = {}
        while at < len(data):
            (length,) = _LENGTH.unpack_from(data, at)
            fields = _fields(data[at + 4 : at + 4 + length])
            at += 4 + length
            (length,) = _LENGTH.unpack_from(data, at)
            at += 4
            if at + length > len(data):
                raise ValueError("a record is cut off")
            op = fields[b"op"][0]
            if op == _CONNECTION:
                self._note_connection(fields, data[at : at + length])
            elif op == _MESSAGE:
                (number,) = _LENGTH.unpack(fields[b"conn"])
                if number not in chosen:
                    channel = self._connections[number]
                    chosen[number] = channel if wanted(channel.topic) else None
                channel_or_none = chosen[number]
                if channel_or_none is not None:
                    log_ns = _nanoseconds(fields[b"time"], 0)
                    out.append(Message(log_ns, channel_or_none, data[at : at + length]))
            at += length


def _nanoseconds(data: bytes, at: int) -> int:
    seconds, nanoseconds = _TIME.unpack_from(data, at)
    return int(seconds * _SECOND + nanoseconds)


def _fields(data: bytes) -> Fields:
    """`length name=value` fields. Raises ValueError where they do not fill `data`."""
    out: Fields = {}
    at = 0
    while at < len(data):
        (length,) = _LENGTH.unpack_from(data, at)
        at += 4
        name, equals, value = data[at : at + length].partition(b"=")
        if not equals or at + length > len(data):
            raise ValueError("a record's header is damaged")
        out[name] = value
        at += length
    return out


def _record_head(file: BinaryIO, size: int, at: int) -> tuple[int, Fields, int, int] | None:
    """Opcode, fields, where the data begin and their length; None where no record is."""
    file.seek(at)
    raw = file.read(4)
    if len(raw) < 4:
        return None
    (length,) = _LENGTH.unpack(raw)
    if not 0 < length <= min(_LONGEST_HEADER, size - at):
        return None
    data = file.read(length + 4)
    try:
        fields = _fields(data[:length])
        op = fields[b"op"][0]
        (data_length,) = _LENGTH.unpack_from(data, length)
    except _FAULTS:
        return None
    if op not in _OPS:
        return None
    return op, fields, at + 4 + length + 4, data_length


def _find_chunk(file: BinaryIO, size: int, at: int) -> int | None:
    """Where the next chunk record begins behind a damaged place."""
    window_bytes, overlap = 1 << 20, 128
    while at < size:
        file.seek(at)
        window = file.read(window_bytes)
        hit = window.find(b"compression=")
        while hit >= 0:
            # The field comes first or after others: a header is at most some tens of bytes.
            for begin in range(max(hit - 64, 0), hit):
                found = _record_head(file, size, at + begin)
                if found is not None and found[0] == _CHUNK:
                    return at + begin
            hit = window.find(b"compression=", hit + 1)
        if len(window) < window_bytes:
            return None
        at += window_bytes - overlap
    return None
