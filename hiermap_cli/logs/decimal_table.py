"""Decimal numbers of many lines at once: the ranges of laser lines are nearly all of a log."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_SPACE, _DOT, _ZERO = ord(" "), ord("."), ord("0")
_LONGEST = 6  # characters of a number, so that its digits fit easily into an int32


class Table(NamedTuple):
    """values: (lines, count) float32; ends: (lines,) where in its line the last number ends."""

    values: NDArray[np.float32]
    ends: NDArray[np.int64]


def read_table(lines: Sequence[bytes], skip: int, count: int) -> Table | None:
    """The `count` numbers behind the first `skip` words of every line.

    Reads numbers of digits and at most one dot, of at most six characters, with one space
    between two words; gives None where a line has anything else, or too few words. The values
    are those of `float`: an integer of the digits over a power of ten, rounded once.
    """
    text = b" ".join(lines) + b" "
    characters = np.frombuffer(text, dtype=np.uint8)
    spaces = np.flatnonzero(characters == _SPACE)
    lengths = np.fromiter(map(len, lines), dtype=np.int64, count=len(lines))
    line_ends = np.cumsum(lengths + 1) - 1
    begins = line_ends - lengths
    first = np.searchsorted(spaces, begins)
    last = first + skip + count - 1
    if last[-1] >= len(spaces) or (spaces[last] > line_ends).any():
        return None
    bounds = spaces[first[:, None] + np.arange(skip - 1, skip + count)]
    ends = bounds[:, 1:]
    widths = ends - bounds[:, :-1] - 1
    if widths.min() < 1 or widths.max() > _LONGEST:
        return None
    values = _numbers(characters, ends, widths)
    return None if values is None else Table(values, ends[:, -1] - begins)


def _numbers(
    characters: NDArray[np.uint8], ends: NDArray[np.int64], widths: NDArray[np.int64]
) -> NDArray[np.float32] | None:
    """The numbers that end before `ends`, digit by digit from the last one."""
    digits = np.zeros(ends.shape, dtype=np.int32)
    power = np.ones(ends.shape, dtype=np.int32)
    scale = np.ones(ends.shape, dtype=np.int32)
    dots = np.zeros(ends.shape, dtype=np.int8)
    for place in range(1, int(widths.max()) + 1):
        character = characters[ends - place]
        inside = widths >= place
        dot = inside & (character == _DOT)
        digit = character - np.uint8(_ZERO)  # what is below "0" wraps to more than nine
        is_digit = inside & ~dot
        if (digit[is_digit] > 9).any():
            return None
        np.copyto(scale, power, where=dot)
        dots += dot
        digits += np.where(is_digit, digit, 0) * power
        np.multiply(power, 10, out=power, where=is_digit)
    if (dots > 1).any() or (widths == dots).any():
        return None
    return (digits / scale).astype(np.float32)
