"""Decimal numbers of many lines at once: the ranges of laser lines are nearly all of a log.

The eight characters up to the end of a number are one integer of 64 bits, and all steps are taken
on these: the dot is found and closed up, the characters are held to be digits, and the digits
become a number by three multiplications (Lemire, "Number parsing at a gigabyte per second",
Software: Practice and Experience 51, 2021).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_SPACE = ord(" ")
_LONGEST = 8  # characters of a number


def _eight(byte: int) -> np.uint64:
    """The same byte eight times."""
    return np.uint64(byte * 0x0101_0101_0101_0101)


_DOTS, _ZEROS = _eight(ord(".")), _eight(ord("0"))
_ONES, _HIGHEST, _ABOVE_NINE = _eight(1), _eight(0x80), _eight(0x80 - 10)
_ALL = _eight(0xFF)
_PLACES = np.uint64(0x0706_0504_0302_0100)  # byte k is k
_PAIRS = np.uint64(0x0000_00FF_0000_00FF)
_FIRST_THIRD = np.uint64(100 + (1_000_000 << 32))
_SECOND_FOURTH = np.uint64(1 + (10_000 << 32))
_POWERS = 10.0 ** np.arange(8)


class Table(NamedTuple):
    """values: (lines, count) float32; ends: (lines,) where in its line the last number ends."""

    values: NDArray[np.float32]
    ends: NDArray[np.int64]


def read_table(lines: Sequence[bytes], skip: int, count: int) -> Table | None:
    """The `count` numbers behind the first `skip` words of every line.

    Reads numbers of digits and at most one dot, of at most eight characters, with one space
    between two words; gives None where a line has anything else, or too few words. The values
    are those of `float`: an integer of the digits over a power of ten, rounded once.
    """
    text = b" " * _LONGEST + b" ".join(lines) + b" "
    characters = np.frombuffer(text, dtype=np.uint8)
    spaces = np.flatnonzero(characters == _SPACE)
    lengths = np.fromiter(map(len, lines), dtype=np.int64, count=len(lines))
    line_ends = _LONGEST + np.cumsum(lengths + 1) - 1
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
    every = np.ndarray((len(text) - 7,), np.dtype("<u8"), text, strides=(1,))
    values = _numbers(every[ends - 8].astype(np.uint64, copy=False), widths.astype(np.uint64))
    return None if values is None else Table(values, ends[:, -1] - begins)


def _numbers(words: NDArray[np.uint64], widths: NDArray[np.uint64]) -> NDArray[np.float32] | None:
    """The numbers that are the last `widths` (1 to 8) characters of words of eight.

    The last character of a word is its highest byte. None where one is no number.
    """
    others = 64 - 8 * widths
    words = (words >> others) << others
    # Of the bytes that are a dot the lowest: its highest bit, or 0 where there is none.
    dot = words ^ _DOTS
    dot = (dot - _ONES) & ~dot & _HIGHEST
    dot &= ~dot + np.uint64(1)
    has_dot = (dot != 0).astype(np.uint64)
    if (widths == has_dot).any():
        return None
    # What is before the dot moves up into its place.
    before = (dot >> 7) - has_dot
    words = (words & ~(dot | (dot - has_dot))) | ((words & before) << 8)
    digits = words ^ (_ZEROS & (_ALL << (others + 8 * has_dot)))
    if ((digits | (digits + _ABOVE_NINE)) & _HIGHEST).any():
        return None
    digits = 10 * digits + (digits >> 8)
    pairs = (digits & _PAIRS) * _FIRST_THIRD + ((digits >> 16) & _PAIRS) * _SECOND_FOURTH
    decimals = ((dot >> 7) * _PLACES) >> 56
    values: NDArray[np.float32] = ((pairs >> 32) / _POWERS[decimals]).astype(np.float32)
    return values
