"""Containers of messages (MCAP, ROS 1 bag, rosbag2) and the reading of them in log order."""

from __future__ import annotations

from heapq import heapify, heappop, heapreplace, merge
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path


class Channel(NamedTuple):
    """A topic with the type and encoding of its messages."""

    topic: str
    type: str
    encoding: str


class Message(NamedTuple):
    """A message not yet decoded, with the time at which the recorder wrote it."""

    log_ns: int
    channel: Channel
    data: bytes


class Container(Protocol):
    """One file of messages, or a part of a split one."""

    path: Path
    losses: list[str]  # what was lost before any message was read: damage of the structure

    def channels(self) -> dict[Channel, int | None]:
        """Channels with the number of their messages where the file says it."""
        ...

    def span(self) -> tuple[int, int]:
        """Log times of the first and the last message, (0, 0) where there are none."""
        ...

    def messages(
        self, wanted: Callable[[str], bool], losses: list[str], *, by_index: bool = False
    ) -> Iterator[Message]:
        """Messages of the wanted topics in log order; what cannot be read goes to `losses`.

        With `by_index` the file's index says where they are; it is quicker for topics with few
        messages, and finds none that a damaged index hides.
        """
        ...


class Piece(NamedTuple):
    """A part of a file that is read at once.

    `begin` and `end` are log times as the file says them; `load` gives the messages in the
    order of the file, and raises nothing: what cannot be read is noted by whoever made it.
    """

    begin: int
    end: int
    load: Callable[[], list[Message]]


def in_log_order(pieces: Sequence[Piece]) -> Iterator[Message]:
    """Messages of all pieces by log time; those of equal time in the order of the file.

    A piece is loaded when the time comes to its beginning, so that only pieces whose times
    overlap are in memory together. Where the file does not say the times, pieces follow each
    other in the order of the file.
    """
    if any(piece.end == 0 for piece in pieces):
        for piece in pieces:
            yield from sorted(piece.load(), key=attrgetter("log_ns"))
        return
    order = sorted(range(len(pieces)), key=lambda i: (pieces[i].begin, i))
    active: list[tuple[int, int, int, list[Message]]] = []
    at = 0
    while at < len(order) or active:
        while at < len(order) and (not active or pieces[order[at]].begin <= active[0][0]):
            loaded = sorted(pieces[order[at]].load(), key=attrgetter("log_ns"))
            if loaded:
                active.append((loaded[0].log_ns, order[at], 0, loaded))
                heapify(active)
            at += 1
        if not active:
            continue
        limit = pieces[order[at]].begin if at < len(order) else None
        if len(active) == 1 and (limit is None or active[0][3][-1].log_ns < limit):
            _, _, position, loaded = active.pop()
            yield from loaded[position:]
            continue
        _, number, position, loaded = active[0]
        yield loaded[position]
        if position + 1 < len(loaded):
            following = loaded[position + 1].log_ns
            heapreplace(active, (following, number, position + 1, loaded))
        else:
            heappop(active)


def ordered(containers: Sequence[Container]) -> list[Container]:
    """The parts of a split recording by the time of their first message."""
    return sorted(containers, key=lambda container: container.span()[0])


def chained(
    containers: Sequence[Container],
    wanted: Callable[[str], bool],
    losses: list[str],
    *,
    by_index: bool = False,
) -> Iterator[Message]:
    """Messages of all parts: one part after the other, or merged where their times overlap."""
    spans = [container.span() for container in containers]
    latest = 0
    overlapping = False
    for begin, end in spans:
        overlapping |= bool(latest) and begin < latest
        latest = max(latest, end)
    if not overlapping:
        for container in containers:
            yield from container.messages(wanted, losses, by_index=by_index)
        return
    streams = [container.messages(wanted, losses, by_index=by_index) for container in containers]
    yield from merge(*streams, key=attrgetter("log_ns"))
