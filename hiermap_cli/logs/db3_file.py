"""rosbag2's SQLite files (.db3), read as far as the database is intact."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING
from urllib.parse import quote

from hiermap_cli.errors import InputError
from hiermap_cli.logs.container import Channel, Message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

MAGIC = b"SQLite format 3\0"

_BATCH = 256  # rows looked at together where a damaged database is searched
_FARTHEST = 1 << 24  # row ids tried behind the last one that could be read


class Db3File:
    """One .db3 file. `name` is the file that the losses speak of.

    Raises InputError where it is no recording of rosbag2, or damaged beyond use.
    """

    def __init__(self, path: Path, name: Path | None = None) -> None:
        self.path = name or path
        self._file = path
        self.losses: list[str] = []
        try:
            with closing(self._open()) as database:
                rows = database.execute("SELECT id, name, type, serialization_format FROM topics")
                self._topics = {
                    int(number): Channel(str(topic), str(kind), str(encoding))
                    for number, topic, kind, encoding in rows
                }
                self._span, self._counts = self._survey(database)
        except (sqlite3.Error, ValueError, TypeError) as error:
            raise InputError(f"{self.path}: no recording of rosbag2: {error}") from error

    def channels(self) -> dict[Channel, int | None]:
        """The table of topics."""
        return {
            channel: None if self._counts is None else self._counts.get(number, 0)
            for number, channel in sorted(self._topics.items())
        }

    def span(self) -> tuple[int, int]:
        """Of the messages' times."""
        return self._span

    def messages(
        self, wanted: Callable[[str], bool], losses: list[str], *, by_index: bool = False
    ) -> Iterator[Message]:
        """Messages of the wanted topics by time; over a damaged place, those behind it."""
        del by_index  # the database has its own
        chosen = [number for number, c in sorted(self._topics.items()) if wanted(c.topic)]
        if not chosen:
            return
        with closing(self._open()) as database:
            last_ns, seen = -(1 << 62), set[int]()
            marks = ",".join("?" * len(chosen))
            query = (
                "SELECT id, topic_id, timestamp, data FROM messages "  # noqa: S608 - marks only
                f"WHERE topic_id IN ({marks}) ORDER BY timestamp, id"
            )
            try:
                for number, topic, stamp, data in database.execute(query, chosen):
                    if stamp != last_ns:
                        seen.clear()
                    last_ns = stamp
                    seen.add(number)
                    yield from self._message(topic, stamp, data, losses)
            except sqlite3.Error as error:
                losses.append(f"{self.path.name}: damaged behind time {last_ns}: {error}")
                yield from self._salvaged(database, set(chosen), (last_ns, seen), losses)

    def _open(self) -> sqlite3.Connection:
        # A database that was not closed has a write-ahead log beside it, which must be read too;
        # everything else is opened as a file that nobody changes, so that nothing is written.
        beside = self._file.with_name(self._file.name + "-wal")
        mode = "mode=ro" if beside.exists() else "mode=ro&immutable=1"
        database = sqlite3.connect(f"file:{quote(str(self._file))}?{mode}", uri=True)
        # Lets SQLite read a file that is shorter than its header says.
        database.execute("PRAGMA writable_schema=ON")
        database.text_factory = lambda data: data.decode("utf-8", "replace")
        return database

    def _survey(
        self, database: sqlite3.Connection
    ) -> tuple[tuple[int, int], dict[int, int] | None]:
        try:
            query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages"
            rows = database.execute(query + " GROUP BY topic_id").fetchall()
        except sqlite3.Error as error:
            self.losses.append(f"{self.path.name}: messages cannot be counted: {error}")
            return (0, 0), None
        self._note_missing(database)
        rows = [row for row in rows if row[0] in self._topics]
        if not rows:
            return (0, 0), {}
        span = min(int(row[2]) for row in rows), max(int(row[3]) for row in rows)
        return span, {int(row[0]): int(row[1]) for row in rows}

    def _note_missing(self, database: sqlite3.Connection) -> None:
        """Recorders number the rows without gaps: a gap is a page that reads as empty."""
        query = "SELECT count(*), min(id), max(id) FROM messages"
        count, first, last = database.execute(query).fetchone()
        if isinstance(first, int) and isinstance(last, int) and last - first + 1 > count:
            missing = last - first + 1 - count
            self.losses.append(f"{self.path.name}: {missing} of its messages are missing")

    def _message(
        self, topic: object, stamp: object, data: object, losses: list[str]
    ) -> Iterator[Message]:
        channel = self._topics.get(topic) if isinstance(topic, int) else None
        if channel is None or not isinstance(stamp, int) or not isinstance(data, bytes):
            losses.append(f"{self.path.name}: a row of messages is damaged")
            return
        yield Message(stamp, channel, data)

    def _salvaged(
        self,
        database: sqlite3.Connection,
        chosen: set[int],
        reached: tuple[int, set[int]],
        losses: list[str],
    ) -> Iterator[Message]:
        """What can be read by row, of what was not read by time; sorted by time."""
        last_ns, seen = reached
        rows = []
        for number, topic, stamp in self._readable_rows(database):
            after = isinstance(stamp, int) and (
                stamp > last_ns or (stamp == last_ns and number not in seen)
            )
            if after and topic in chosen:
                rows.append((stamp, number, topic))
        lost = 0
        for stamp, number, topic in sorted(rows):
            try:
                row = database.execute(
                    "SELECT data FROM messages WHERE id = ?", (number,)
                ).fetchone()
            except sqlite3.Error:
                row = None
            if row is None:
                lost += 1
            else:
                yield from self._message(topic, stamp, row[0], losses)
        if lost:
            losses.append(f"{self.path.name}: {lost} messages cannot be read")

    def _readable_rows(self, database: sqlite3.Connection) -> Iterator[Sequence[int]]:
        """Ids, topics and times by row id, with growing steps over rows that cannot be read."""
        after, step = -1, 1
        while step < _FARTHEST:
            try:
                rows = database.execute(
                    "SELECT id, topic_id, timestamp FROM messages WHERE id > ? ORDER BY id LIMIT ?",
                    (after, _BATCH if step == 1 else 1),
                ).fetchall()
            except sqlite3.Error:
                rows = None
            if rows is not None and not rows:
                return
            # A damaged tree may lead back to rows before: only rows that go on count.
            last = rows[-1][0] if rows else None
            if isinstance(last, int) and last > after:
                yield from rows or ()
                after, step = last, 1
            else:
                after += step
                step *= 2
