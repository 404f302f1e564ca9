"""Tables and text in Markdown, as a pull request or the summary of a CI job shows them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_SPECIAL = str.maketrans(
    {"|": "\\|", "\\": "\\\\", "`": "\\`", "*": "\\*", "<": "&lt;", ">": "&gt;", "[": "\\["}
)


def markdown_text(text: str) -> str:
    """The text on one line, with nothing in it that Markdown or HTML would take for a mark."""
    line = " ".join(text.split())
    return "".join(c for c in line if c.isprintable()).translate(_SPECIAL)


def markdown_table(
    head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()
) -> str:
    """A table of GitHub's Markdown.

    Args:
        head: names of the columns.
        rows: as many cells each, plain text; marks in them are taken away from Markdown.
        numbers: columns that are set to the right.
    """
    right = set(numbers)
    rule = ["---:" if i in right else "---" for i in range(len(head))]
    lines = [_row([markdown_text(cell) for cell in head]), _row(rule)]
    lines += [_row([markdown_text(cell) for cell in row]) for row in rows]
    return "\n".join(lines) + "\n"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def figure(value: float | None, digits: int = 4) -> str:
    """A number for a person: so many significant digits, no exponent where it can be spared."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e6:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        text = f"{value:.{places}f}"
        return text.rstrip("0").rstrip(".") if "." in text else text
    return f"{value:.{digits - 1}e}"
