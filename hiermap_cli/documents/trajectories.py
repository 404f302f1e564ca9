"""Writing of trajectories (TUM) and of their covariances; reading of the covariances.

Stamps are printed from integer nanoseconds with nine decimals, never through a float: a second
of today's epoch has no room left for nanoseconds in 64 bits.
"""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.documents.checks import UnsoundValueError, first_bad_covariance, sound_array
from hiermap_cli.documents.tum import read_number_lines, stamp_text

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_CHUNK = 4096  # lines formatted at once: fast, and small beside the trajectory itself
_UPPER = ([0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2])  # xx xy xt yy yt tt


class TimedCovariances(NamedTuple):
    """Covariances of a trajectory: stamps_ns (N,) int64, covariances (N, 3, 3) in g.

    line_numbers: of each, in its file.
    """

    stamps_ns: NDArray[np.int64]
    covariances: Array
    line_numbers: list[int]


def write_tum(file: IO[str], stamps_ns: NDArray[np.int64], poses: Array) -> None:
    """Poses (N, 3) as lines `t x y z qx qy qz qw`, with z, qx and qy zero.

    Raises:
        UnsoundValueError: a pose is not finite, or there is not one stamp a pose.
    """
    poses = _checked(stamps_ns, poses, 3)
    # Rounding first, then adding zero, so that no "-0.000000000" depends on the last bit.
    position = np.round(poses[:, :2], 9) + 0.0
    half = 0.5 * poses[:, 2]
    rows = np.column_stack((position, np.round(np.sin(half), 12) + 0.0, np.cos(half)))
    _write_lines(file, stamps_ns, rows, "%s %.9f %.9f 0 0 0 %.12f %.12f\n")


def write_covariances(file: IO[str], stamps_ns: NDArray[np.int64], covariances: Array) -> None:
    """Covariances (N, 3, 3) as lines `t xx xy xt yy yt tt`.

    Raises:
        UnsoundValueError: one is not a covariance, or there is not one stamp a covariance.
    """
    covariances = np.asarray(covariances, dtype=float).reshape(-1, 3, 3)
    bad = first_bad_covariance(covariances)
    if bad is not None:
        raise UnsoundValueError(f"the covariance of pose {bad[0]} of the trajectory {bad[1]}")
    rows = covariances[:, _UPPER[0], _UPPER[1]] + 0.0
    _write_lines(file, stamps_ns, _checked(stamps_ns, rows, 6), "%s" + " %.14e" * 6 + "\n")


def read_covariances(path: Path) -> TimedCovariances:
    """The covariances in a file that `write_covariances` wrote.

    Raises:
        InputError: the file cannot be read, is empty, or a line is not seven finite numbers.
    """
    table = read_number_lines(path, 7, "t xx xy xt yy yt tt")
    covariances = np.empty((len(table.values), 3, 3))
    covariances[:, _UPPER[0], _UPPER[1]] = table.values[:, 1:]
    covariances[:, _UPPER[1], _UPPER[0]] = table.values[:, 1:]
    return TimedCovariances(table.stamps_ns[:, 0], covariances, table.line_numbers)


def _checked(stamps_ns: NDArray[np.int64], values: Array, columns: int) -> Array:
    values = sound_array(values, "the trajectory").reshape(-1, columns)
    if len(values) != len(stamps_ns):
        raise UnsoundValueError(f"the trajectory has {len(stamps_ns)} stamps, {len(values)} rows")
    return values


def _write_lines(file: IO[str], stamps_ns: NDArray[np.int64], rows: Array, line: str) -> None:
    """One line a row: its stamp as text, then its numbers, by one `%` for many lines."""
    for first in range(0, len(rows), _CHUNK):
        chunk = rows[first : first + _CHUNK]
        stamps = stamps_ns[first : first + _CHUNK].tolist()
        file.write((line * len(chunk)) % tuple(_interleaved(stamps, chunk)))


def _interleaved(stamps_ns: list[int], rows: Array) -> Iterator[str | float]:
    for stamp_ns, row in zip(stamps_ns, rows.tolist(), strict=True):
        yield stamp_text(stamp_ns)
        yield from row
