"""A recording in containers of messages: their topics, and their messages decoded."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from hiermap_cli.logs import records as kinds
from hiermap_cli.logs.compression import plain_message
from hiermap_cli.logs.container import chained, ordered
from hiermap_cli.logs.decoders import DECODE_ERRORS, Meaning, meaning
from hiermap_cli.logs.ranges import HEAD_SCANS, float32, infer_range_max
from hiermap_cli.logs.raw import RawScan, finish
from hiermap_cli.logs.records import Record, Topic, Transform
from hiermap_cli.logs.source import Part

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from hiermap_cli.logs.container import Channel, Container, Message

# No laser sees as far as this (metres): a scan that states its reach keeps it.
_UNLIMITED = float32(1e6)


class MessageLog:
    """One or several containers, the parts of one recording, as a `Source`."""

    def __init__(
        self, log_format: str, containers: Sequence[Container], losses: Sequence[str] = ()
    ) -> None:
        self.format = log_format
        self.twice: tuple[str, ...] = ()
        self._containers = ordered(containers)
        self._found = [*losses, *(loss for c in self._containers for loss in c.losses)]
        self.losses = list(self._found)
        self.paths: list[Path] = [container.path for container in self._containers]
        self._meanings: dict[Channel, Meaning | None] = {}
        self._reach: dict[str, float] = {}

    def topics(self) -> list[Topic]:
        """All topics by name, with the number of their messages where all parts say it."""
        return [
            Topic(channel.topic, channel.type, channel.encoding, self._kind(channel), messages)
            for channel, messages in sorted(self._channels().items())
        ]

    def _channels(self) -> dict[Channel, int | None]:
        found: dict[Channel, int | None] = {}
        for container in self._containers:
            for channel, messages in container.channels().items():
                before = found.get(channel, 0)
                known = before is not None and messages is not None
                found[channel] = before + messages if known else None  # type: ignore[operator]
        return found

    def static_transforms(self) -> Iterator[Transform]:
        """The transforms of all static topics, wherever in the recording they are."""
        static = frozenset(t.name for t in self.topics() if t.kind == kinds.STATIC_TRANSFORMS)
        if static:
            messages = chained(self._containers, static.__contains__, [], by_index=True)
            for message in messages:
                for record in self._decoded(message):
                    if isinstance(record.value, Transform):
                        yield record.value

    def records(self, wanted: frozenset[str] | None = None) -> Iterator[Record]:
        """Decoded values in log order."""
        self.losses = list(self._found)
        choose = wanted.__contains__ if wanted is not None else _all
        read: Counter[Channel] = Counter()
        for message in chained(self._containers, choose, self.losses):
            read[message.channel] += 1
            yield from self._decoded(message)
        for channel, announced in self._channels().items():
            if announced is not None and choose(channel.topic) and read[channel] < announced:
                missing = f"{announced - read[channel]} of {announced} messages"
                self.losses.append(f"{channel.topic}: {missing} that the index counts are missing")

    def parts(self) -> list[Part]:
        """The containers, with their log times."""
        containers = self._containers
        return [Part(MessageLog(self.format, [c]), c.span()) for c in containers]

    def _kind(self, channel: Channel) -> str:
        found = self._meaning(channel)
        return found.kind if found is not None else kinds.OTHER

    def _meaning(self, channel: Channel) -> Meaning | None:
        if channel not in self._meanings:
            self._meanings[channel] = meaning(channel.topic, channel.type, channel.encoding)
        return self._meanings[channel]

    def _decoded(self, message: Message) -> Iterator[Record]:
        topic, log_ns = message.channel.topic, message.log_ns
        found = self._meaning(message.channel)
        if found is None:
            yield Record(topic, log_ns, None)
            return
        try:
            values = found.decode(plain_message(message.data))
        except DECODE_ERRORS as error:
            yield Record(topic, log_ns, None, f"undecodable message: {error}")
            return
        for value in values:
            if isinstance(value, RawScan):
                reach = _UNLIMITED if value.range_max is not None else self._reach_of(topic)
                yield Record(topic, log_ns, finish(value, reach))
            else:
                yield Record(topic, log_ns, value)

    def _reach_of(self, topic: str) -> float:
        """The range at which a laser of unstated reach saturates, from its first scans."""
        if topic not in self._reach:
            head = []
            for message in chained(self._containers, topic.__eq__, []):
                found = self._meaning(message.channel)
                try:
                    values = found.decode(plain_message(message.data)) if found is not None else ()
                except DECODE_ERRORS:
                    continue
                head += [value.ranges for value in values if isinstance(value, RawScan)]
                if len(head) >= HEAD_SCANS:
                    break
            self._reach[topic] = infer_range_max(head)
        return self._reach[topic]


def _all(topic: str) -> bool:
    del topic
    return True
