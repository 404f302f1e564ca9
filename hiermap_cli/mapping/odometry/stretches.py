"""Stretches of the log over which something was wrong, as events with a begin and an end."""

from __future__ import annotations

from dataclasses import dataclass, field

from hiermap_cli.mapping.model import Event


@dataclass(slots=True)
class Stretches:
    """At most one open stretch of each kind; `events` is the mapper's own list.

    An event has its place in the list from when it was noticed, and the time of its begin. Its
    `begin` and `end` are seconds in the log's time, as an event's `t`.
    """

    events: list[Event]
    _open: dict[str, int] = field(default_factory=dict)

    def begin(self, kind: str, begin_ns: int, end_ns: int, **details: object) -> None:
        """A stretch from `begin_ns` on, so far up to `end_ns`; one that is open goes on."""
        if kind in self._open:
            self.extend(kind, end_ns)
            return
        self._open[kind] = len(self.events)
        span = {"begin": begin_ns / 1e9, "end": end_ns / 1e9}
        self.events.append(Event(begin_ns, kind, {**details, **span}))

    def note(self, kind: str, begin_ns: int, end_ns: int, **details: object) -> None:
        """A stretch that is over as it is noticed, at its end."""
        span = {"begin": begin_ns / 1e9, "end": end_ns / 1e9}
        self.events.append(Event(end_ns, kind, {**details, **span}))

    def extend(self, kind: str, end_ns: int) -> None:
        """An open stretch lasts at least until then; nothing where none is open."""
        at = self._open.get(kind)
        if at is not None:
            event = self.events[at]
            end = max(end_ns / 1e9, event.stamp_ns / 1e9)
            self.events[at] = Event(event.stamp_ns, kind, {**event.details, "end": end})

    def end(self, kind: str, end_ns: int | None = None) -> None:
        """A stretch is over: then, or when it was last known to last."""
        if end_ns is not None:
            self.extend(kind, end_ns)
        self._open.pop(kind, None)
