"""MCAP files, read chunk by chunk; every chunk stands or falls alone.

A chunk whose checksum does not hold is left out whole: a message in it may be the damaged one,
and nothing tells which. A chunk that the end of the file cuts off gives its whole messages.
"""

from __future__ import annotations

import io
import struct
import zlib
from typing import TYPE_CHECKING, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Footer, Schema, Statistics

from hiermap_cli.errors import InputError
from hiermap_cli.logs.compression import DECOMPRESS_ERRORS, decompress
from hiermap_cli.logs.container import Channel, Message, Piece, in_log_order
from hiermap_cli.logs.mcap_walk import ChunkHead, Found, chunk_head, walk

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from typing import BinaryIO

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_LOOSE_BYTES = 1 << 20  # messages outside of chunks are read in pieces of about this size
_LARGEST_CHUNK = 1 << 31

PARSE_ERRORS: tuple[type[BaseException], ...] = (
    McapError,
    struct.error,
    ValueError,
    KeyError,
    IndexError,
    OverflowError,
)


class _Unread(NamedTuple):
    """A piece of the file before it is read: a chunk, or loose records in a row."""

    begin_ns: int
    end_ns: int
    at: int
    length: int
    chunk: ChunkHead | None
    whole: bool
    messages: int | None
    channels: frozenset[int] | None  # in it, by its index; None where it has none


class McapFile:
    """One MCAP file. `name` is the file that the losses speak of.

    Raises InputError where it cannot be opened or nothing is in it.
    """

    def __init__(self, path: Path, name: Path | None = None) -> None:
        self.path = name or path
        self._file = path
        self.losses: list[str] = []
        self._schemas: dict[int, Schema] = {}
        self._records: dict[int, ChannelRecord] = {}
        self._counts: dict[int, int] | None = None
        self._pieces: list[_Unread] = []
        self._summarised = False
        try:
            self._size = path.stat().st_size
            with path.open("rb") as file:
                self._survey(file)
                if not self._summarised:
                    self._gather_channels(file)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror or error}") from error
        self.losses = [f"{self.path.name}: {loss}" for loss in self.losses]
        if not self._pieces:
            reason = f" ({self.losses[0]})" if self.losses else ""
            raise InputError(f"{self.path}: no messages in it{reason}")

    def channels(self) -> dict[Channel, int | None]:
        """Channels by the summary, or where it is damaged by the chunks."""
        out: dict[Channel, int | None] = {}
        for number in sorted(self._records):
            channel = self._channel(number)
            if channel is not None:
                count = None if self._counts is None else self._counts.get(number, 0)
                before = out.get(channel, 0)
                out[channel] = before + count if None not in (before, count) else None  # type: ignore[operator]
        return out

    def span(self) -> tuple[int, int]:
        """By the heads of the chunks."""
        begins = [piece.begin_ns for piece in self._pieces if piece.end_ns]
        return (min(begins), max(p.end_ns for p in self._pieces)) if begins else (0, 0)

    def messages(
        self, wanted: Callable[[str], bool], losses: list[str], *, by_index: bool = False
    ) -> Iterator[Message]:
        """Messages of the wanted topics by log time."""
        try:
            with self._file.open("rb") as file:
                pieces = [
                    Piece(p.begin_ns, p.end_ns, self._loader(file, p, wanted, losses))
                    for p in self._pieces
                    if not by_index or self._may_hold(p, wanted)
                ]
                yield from in_log_order(pieces)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error}") from error

    def _may_hold(self, piece: _Unread, wanted: Callable[[str], bool]) -> bool:
        """Whether a piece may hold a wanted topic: without an index, any may."""
        if piece.channels is None or not piece.channels <= self._records.keys():
            return True
        return any(wanted(self._records[number].topic) for number in piece.channels)

    def _survey(self, file: BinaryIO) -> None:
        """Finds the pieces, and what the summary says."""
        loose: list[Found] = []
        summary: list[Found] = []
        after_data = False
        for found in walk(file, self._size, self.losses):
            if found.opcode == Opcode.DATA_END:
                self._note_loose(file, loose)
                self._check_data(file, found)
                after_data = True
            elif found.opcode == Opcode.CHUNK:
                self._note_loose(file, loose)
                self._note_chunk(file, found)
            elif found.opcode == Opcode.MESSAGE_INDEX:
                self._note_index(file, found)
            elif found.opcode == Opcode.FOOTER:
                self._read_summary(file, found, summary)
            elif after_data:
                summary.append(found)
            elif found.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                if loose and (
                    found.at + found.length - loose[0].at > _LOOSE_BYTES
                    or found.at - _HEAD.size != loose[-1].at + loose[-1].length
                ):
                    self._note_loose(file, loose)
                loose.append(found)
        self._note_loose(file, loose)

    def _check_data(self, file: BinaryIO, data_end: Found) -> None:
        """Messages outside of chunks have no checksum but that of the whole data section."""
        file.seek(data_end.at)
        (crc,) = struct.unpack("<I", file.read(4))
        if crc and any(piece.chunk is None for piece in self._pieces):
            left = data_end.at - _HEAD.size
            file.seek(0)
            own = 0
            while left > 0 and (data := file.read(min(left, _LOOSE_BYTES))):
                own = zlib.crc32(data, own)
                left -= len(data)
            if own != crc:
                self.losses.append("the checksum of the data does not hold: some are damaged")

    def _note_chunk(self, file: BinaryIO, found: Found) -> None:
        head = chunk_head(file, found)
        if head is None or head.at + head.length > found.at + found.length:
            self.losses.append(f"chunk at byte {found.at} has no head that makes sense")
            return
        begin, end = (head.start_ns, head.end_ns) if head.end_ns >= head.start_ns else (0, 0)
        length = min(head.length, self._size - head.at)
        self._pieces.append(_Unread(begin, end, head.at, length, head, found.whole, None, None))

    def _note_index(self, file: BinaryIO, found: Found) -> None:
        """Counts the messages of one channel in the chunk before it: 16 bytes an entry."""
        if self._pieces:
            last = self._pieces[-1]
            entries = (found.length - 6) // 16
            file.seek(found.at)
            (number,) = struct.unpack("<H", file.read(2))
            self._pieces[-1] = last._replace(
                messages=(last.messages or 0) + entries,
                channels=(last.channels or frozenset()) | {number},
            )

    def _note_loose(self, file: BinaryIO, loose: list[Found]) -> None:
        if any(found.opcode == Opcode.MESSAGE for found in loose):
            times, numbers = [], set()
            for found in loose:
                if found.opcode == Opcode.MESSAGE:
                    file.seek(found.at)
                    number, _, log_ns, _ = _MESSAGE.unpack(file.read(_MESSAGE.size))
                    times.append(log_ns)
                    numbers.add(number)
            begin = loose[0].at - _HEAD.size
            length = loose[-1].at + loose[-1].length - begin
            length = min(length, self._size - begin)
            whole, channels = loose[-1].whole, frozenset(numbers)
            bounds = min(times), max(times)
            self._pieces.append(_Unread(*bounds, begin, length, None, whole, len(times), channels))
        elif loose:
            begin = loose[0].at - _HEAD.size
            file.seek(begin)
            self._parse(file.read(loose[-1].at + loose[-1].length - begin), lambda _: False, [])
        loose.clear()

    def _read_summary(self, file: BinaryIO, footer: Found, summary: list[Found]) -> None:
        """Schemas, channels and counts of the summary, if its checksum holds."""
        file.seek(footer.at)
        data = file.read(footer.length)
        end = Footer.read(ReadDataStream(io.BytesIO(data)))
        if end.summary_start > self._size:
            self.losses.append("the footer is damaged: the summary lies beyond the end")
            return
        if end.summary_crc and end.summary_start:
            file.seek(end.summary_start)
            # The checksum reaches to the footer's own last field.
            covered = file.read(max(footer.at + footer.length - 4 - end.summary_start, 0))
            if zlib.crc32(covered) != end.summary_crc:
                self.losses.append("the summary is damaged: its checksum does not hold")
                return
        for found in summary:
            file.seek(found.at)
            stream = ReadDataStream(io.BytesIO(file.read(found.length)))
            try:
                if found.opcode == Opcode.SCHEMA:
                    schema = Schema.read(stream)
                    self._schemas[schema.id] = schema
                elif found.opcode == Opcode.CHANNEL:
                    record = ChannelRecord.read(stream)
                    self._records[record.id] = record
                elif found.opcode == Opcode.STATISTICS:
                    self._counts = dict(Statistics.read(stream).channel_message_counts)
            except PARSE_ERRORS as error:
                self.losses.append(f"summary record at byte {found.at} is damaged: {error}")
                return
        self._summarised = bool(self._records)

    def _gather_channels(self, file: BinaryIO) -> None:
        """Channels out of the chunks themselves, where no summary tells them."""
        for piece in self._pieces:
            self._loader(file, piece, lambda _: False, [])()

    def _loader(
        self,
        file: BinaryIO,
        piece: _Unread,
        wanted: Callable[[str], bool],
        losses: list[str],
    ) -> Callable[[], list[Message]]:
        def load() -> list[Message]:
            try:
                data = self._piece_data(file, piece)
            except (*DECOMPRESS_ERRORS, *PARSE_ERRORS) as error:
                many = "an unknown number of" if piece.messages is None else piece.messages
                losses.append(
                    f"{self.path.name}: chunk at byte {piece.at} is damaged: "
                    f"{many} messages lost: {error}"
                )
                return []
            faults: list[str] = []
            messages = self._parse(data, wanted, faults)
            if piece.whole:
                losses.extend(f"{self.path.name}: piece at byte {piece.at}: {f}" for f in faults)
            return messages

        return load

    def _piece_data(self, file: BinaryIO, piece: _Unread) -> bytes:
        file.seek(piece.at)
        stored = file.read(piece.length)
        head = piece.chunk
        if head is None:
            return stored
        if head.size > _LARGEST_CHUNK:
            raise ValueError(f"a chunk of {head.size} bytes")
        data = decompress(head.compression, stored, head.size, cut_off=not piece.whole)
        if piece.whole and head.crc and zlib.crc32(data) != head.crc:
            raise ValueError("its checksum does not hold")
        return data

    def _parse(
        self, data: bytes, wanted: Callable[[str], bool], faults: list[str]
    ) -> list[Message]:
        """Messages among the records of a piece; schemas and channels are kept."""
        out: list[Message] = []
        chosen: dict[int, Channel | None] = {}
        at, end = 0, len(data)
        while at + _HEAD.size <= end:
            opcode, length = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if at + length > end:
                break
            if opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
                number, _, log_ns, _ = _MESSAGE.unpack_from(data, at)
                if number not in chosen:
                    channel = self._channel(number)
                    if channel is None:
                        faults.append(f"messages of a channel that is not declared ({number})")
                    chosen[number] = channel if channel and wanted(channel.topic) else None
                channel = chosen[number]
                if channel is not None:
                    body = data[at + _MESSAGE.size : at + length]
                    out.append(Message(log_ns, channel, body))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._declare(opcode, data[at : at + length], chosen, faults)
            at += length
        if at < end:
            faults.append("its last record is cut off")
        return out

    def _declare(
        self, opcode: int, body: bytes, chosen: dict[int, Channel | None], faults: list[str]
    ) -> None:
        stream = ReadDataStream(io.BytesIO(body))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
            else:
                record = ChannelRecord.read(stream)
                self._records[record.id] = record
                chosen.pop(record.id, None)
        except PARSE_ERRORS as error:
            faults.append(f"a declaration is damaged: {error}")

    def _channel(self, number: int) -> Channel | None:
        record = self._records.get(number)
        if record is None:
            return None
        schema = self._schemas.get(record.schema_id)
        name = schema.name if schema is not None else ""
        return Channel(record.topic, name, record.message_encoding)
