"""What every format's reader offers to the rest of the program."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from hiermap_cli.logs.records import Record, Topic, Transform


class Part(NamedTuple):
    """One file of a recording as a source of its own.

    `span` has the log times of its first and last message, (0, 0) where there are none or a
    damaged file does not say them; None where only reading tells.
    """

    source: Source
    span: tuple[int, int] | None


class Source(Protocol):
    """One recording: a file, or the parts of a split one, read as often as asked.

    `losses` says what could not be read of a damaged file, a line each; it is complete once
    `records` has been read to its end, and begins anew with each reading.
    """

    paths: list[Path]
    format: str
    losses: list[str]
    twice: tuple[str, ...]  # what to say of files that were given more than once

    def topics(self) -> list[Topic]:
        """The topics as far as they are known without reading the whole."""
        ...

    def static_transforms(self) -> Iterator[Transform]:
        """The static edges of the tree of frames, wherever in the recording they are."""
        ...

    def records(self, wanted: frozenset[str] | None = None) -> Iterator[Record]:
        """Values in log order: of all topics, or of the wanted ones only.

        Raises InputError where the recording cannot be read at all.
        """
        ...

    def parts(self) -> list[Part]:
        """The recording's files, each by itself."""
        ...
