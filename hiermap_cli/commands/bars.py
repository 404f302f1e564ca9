"""Progress bars that fit the terminal: the count is whole, the rest is as its room allows."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

_NAME, _COUNT, _LEFT, _SAID, _BAR = 12, 16, 8, 15, 6  # characters, the space between included
_WIDEST = 40  # characters of a bar, and of a name


class Parts(NamedTuple):
    """What there is room for: characters of the name and of the bar, 0 for none."""

    name: int
    bar: int
    said: bool
    left: bool


def parts_of(width: int) -> Parts:
    """What of a bar a terminal of `width` characters has room for."""
    rest = width - _COUNT
    name = min(_NAME, max(rest - 1, 0))
    rest -= name + 1
    left = rest >= _LEFT
    rest -= _LEFT * left
    said = rest >= _SAID
    rest -= _SAID * said
    if rest < _BAR:
        return Parts(name, 0, said, left)
    bar = min(_WIDEST, max(2 * rest // 3, _BAR))
    return Parts(min(_WIDEST, name + rest - bar - 1), bar, said, left)


def room_for(console: Console, *, elapsed: bool = False) -> Parts:
    """What there is room for on `console`, beside the time elapsed where that is shown."""
    return parts_of(console.width - (_LEFT if elapsed else 0))


def progress_bars(console: Console, field: str, *, elapsed: bool = False) -> Progress:
    """Bars on `console`; `field` is the tasks' field that is shown behind the count."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.table import Column

    parts = room_for(console, elapsed=elapsed)
    name = Column(no_wrap=True, overflow="ellipsis", max_width=max(parts.name, 1))
    columns: list[ProgressColumn] = [
        TextColumn("{task.description}", markup=False, table_column=name)
    ]
    if parts.bar:
        columns.append(BarColumn(bar_width=parts.bar))
    columns.append(MofNCompleteColumn(table_column=Column(no_wrap=True)))
    if parts.said:
        columns.append(TextColumn(f"{{task.fields[{field}]}}", markup=False))
    if elapsed:
        columns.append(TimeElapsedColumn())
    if parts.left:
        columns.append(TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True)
