"""Reading of trajectories in the TUM format: `t x y z qx qy qz qw`, one pose a line.

Only the planar part (x, y, yaw) is kept. Stamps are read as decimals, so that nine decimals of
an epoch time become exact nanoseconds.
"""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

TUM_COLUMNS = "t x y z qx qy qz qw"
NORM_TOLERANCE = 1e-3  # of a quaternion: other programs print three decimals
_LATEST_S = 9.2e9  # seconds that still fit into 64 bits of nanoseconds


class TimedPoses(NamedTuple):
    """Poses in some frame, in the order of the file.

    stamps_ns: (N,) int64. poses: (N, 3), `[x, y, theta]` in metres and radians.
    """

    stamps_ns: NDArray[np.int64]
    poses: Array


def read_tum(path: Path) -> TimedPoses:
    """The trajectory in a TUM file; lines that begin with # are comments.

    Raises:
        InputError: the file cannot be read, has no pose, holds relations, a line is not eight
            finite numbers, a quaternion has not the length 1, or stamps go back; the message
            names file and line.
    """
    table = read_number_lines(path, 8, TUM_COLUMNS)
    if looks_like_relations(table):
        raise InputError(
            f"{path}: holds relations (t1 t2 x y z roll pitch yaw), no trajectory "
            f"({TUM_COLUMNS}): its last four columns are no quaternions"
        )
    faults = sorted(tum_faults(table))
    if faults:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise InputError(f"{path}:{faults[0].line}: {faults[0].message}{more}")
    quaternions = table.values[:, 4:8]
    qx, qy, qz, qw = (quaternions / np.linalg.norm(quaternions, axis=1)[:, None]).T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    poses = np.column_stack((table.values[:, 1:3], yaw))
    return TimedPoses(table.stamps_ns[:, 0], poses)


class LineFault(NamedTuple):
    """What is wrong with a line of a file, counted from 1."""

    line: int
    message: str


def tum_faults(table: NumberLines) -> list[LineFault]:
    """Every line of a trajectory whose quaternion has not the length 1 or whose stamp goes back."""
    norms = _norms(table)
    faults = [
        LineFault(
            table.line_numbers[i],
            f"the quaternion has length {norms[i]:.9g}, not 1"
            if norms[i]
            else "the quaternion is zero; it must have length 1",
        )
        for i in np.flatnonzero(np.abs(norms - 1.0) > NORM_TOLERANCE)
    ]
    return faults + stamp_faults(table.stamps_ns[:, 0], table.line_numbers)


def stamp_faults(stamps_ns: NDArray[np.int64], line_numbers: list[int]) -> list[LineFault]:
    """Stamps (N,) that go back; equal ones are allowed, since a log may repeat a stamp."""
    return [
        LineFault(
            line_numbers[i],
            f"the stamp {stamp_text(stamps_ns[i])} comes after {stamp_text(stamps_ns[i - 1])}; "
            "stamps may not go back",
        )
        for i in np.flatnonzero(np.diff(stamps_ns) < 0) + 1
    ]


def looks_like_relations(table: NumberLines) -> bool:
    """Whether lines of eight numbers are relations `t1 t2 x y z roll pitch yaw`, not poses.

    Most have a second column that is a later stamp, and last columns that are no quaternion.
    """
    later = table.values[:, 1] > table.values[:, 0]
    return bool((later & (np.abs(_norms(table) - 1.0) > NORM_TOLERANCE)).mean() > 0.5)


def looks_like_poses(table: NumberLines) -> bool:
    """Whether lines of eight numbers are poses `t x y z qx qy qz qw`, not relations.

    Most have last columns that are a quaternion, and a second one that is no later stamp.
    """
    later = table.values[:, 1] > table.values[:, 0]
    return bool((~later & (np.abs(_norms(table) - 1.0) <= NORM_TOLERANCE)).mean() > 0.5)


def _norms(table: NumberLines) -> Array:
    """Lengths (N,) of the last four columns."""
    norms: Array = np.linalg.norm(table.values[:, 4:8], axis=1)
    return norms


def stamp_text(stamp_ns: int | np.int64) -> str:
    """Seconds with nine decimals, exactly."""
    seconds, nanoseconds = divmod(abs(int(stamp_ns)), 1_000_000_000)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{nanoseconds:09d}"


class NumberLines(NamedTuple):
    """Lines of numbers: values (N, columns), exact stamps (N, stamp columns), line numbers."""

    values: Array
    stamps_ns: NDArray[np.int64]
    line_numbers: list[int]


def read_number_lines(path: Path, columns: int, names: str, stamp_columns: int = 1) -> NumberLines:
    """Every line of `path` that is neither blank nor a comment, as `columns` finite numbers.

    The first `stamp_columns` are stamps in seconds; `names` says the columns in messages.

    Raises:
        InputError: as `read_tum`.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected lines of {names}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})") from None
    lines: list[list[str]] = []
    line_numbers: list[int] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != columns:
            raise InputError(
                f"{path}:{number}: {len(words)} columns where {columns} are needed: {names}"
            )
        lines.append(words)
        line_numbers.append(number)
    if not lines:
        raise InputError(f"{path}: holds no line of {names}")
    try:
        values = np.array(lines, dtype=np.float64)
    except ValueError:
        values = _parse_slowly(path, lines, line_numbers)
    usable = np.isfinite(values).all(axis=1) & (np.abs(values[:, :stamp_columns]) < _LATEST_S).all(
        axis=1
    )
    if not usable.all():
        bad = int(np.argmin(usable))
        raise InputError(
            f"{path}:{line_numbers[bad]}: '{' '.join(lines[bad])}' has a value that is not finite "
            f"or a stamp beyond any clock; expected {names}"
        )
    stamps_ns = np.array(
        [[_stamp_ns(word) for word in words[:stamp_columns]] for words in lines], dtype=np.int64
    )
    return NumberLines(values, stamps_ns, line_numbers)


def _parse_slowly(path: Path, lines: list[list[str]], line_numbers: list[int]) -> Array:
    """Word by word, to name the first one that is no number."""
    values = np.empty((len(lines), len(lines[0])))
    for row, (words, number) in enumerate(zip(lines, line_numbers, strict=True)):
        for column, word in enumerate(words):
            try:
                values[row, column] = float(word)
            except ValueError:
                raise InputError(f"{path}:{number}: '{word}' is not a number") from None
    return values


def _stamp_ns(word: str) -> int:
    """Decimal seconds to integer nanoseconds, rounded to the nearest."""
    try:
        return int((Decimal(word) * 1_000_000_000).to_integral_value())
    except InvalidOperation:  # more digits than a decimal context holds: no clock has them
        return round(float(word) * 1e9)
