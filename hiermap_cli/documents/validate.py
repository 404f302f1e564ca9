"""Which document a file is, and whether it holds: shape and semantics, every fault listed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hiermap_cli.documents import model_file, report_file, shapes
from hiermap_cli.documents.checks import first_bad_covariance
from hiermap_cli.documents.reading import check_format, read_json, shape_faults
from hiermap_cli.documents.reference import read_reference
from hiermap_cli.documents.relations import read_relations
from hiermap_cli.documents.semantics import eval_faults, model_faults, report_faults
from hiermap_cli.documents.trajectories import read_covariances, stamp_text
from hiermap_cli.documents.tum import read_number_lines, read_tum
from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

NORM_TOLERANCE = 1e-6  # of a quaternion: other programs print few digits
_MAX_LISTED = 50


class Verdict(NamedTuple):
    """What a file is, and what is wrong with it: nothing where `faults` is empty."""

    kind: str
    faults: list[str]


class _Known(NamedTuple):
    version: tuple[int, int]
    shape: type[shapes.Shape]
    semantics: Callable[[Any], list[str]]


def _nothing(_: Any) -> list[str]:
    return []


_JSON = {
    model_file.FORMAT: _Known(model_file.VERSION, shapes.ModelDocument, model_faults),
    report_file.FORMAT: _Known(report_file.VERSION, shapes.ReportDocument, report_faults),
    "hiermap-eval": _Known((1, 0), shapes.EvalDocument, eval_faults),
    "hiermap-reference": _Known((1, 0), shapes.ReferenceDocument, _nothing),
    "hiermap-summary": _Known((1, 0), shapes.SummaryDocument, _nothing),
    "hiermap-job": _Known((1, 0), shapes.JobDocument, _nothing),
}
FORMATS = tuple(_JSON)


def check_file(path: Path) -> Verdict:
    """What the file is, by its format key or its name, and every fault in it.

    YAML is not looked at here: what a configuration, a world or jobs may hold is known by those
    who read them.

    Raises:
        InputError: the file cannot be read, or is of no known kind.
    """
    name = path.name.lower()
    if name.endswith(".tum"):
        return _check_tum(path)
    if name.endswith(".txt"):
        return _check_text(path)
    return _check_json(path)


def _check_json(path: Path) -> Verdict:
    document = read_json(path)
    given = document.get("format") if isinstance(document, dict) else None
    known = _JSON.get(given) if isinstance(given, str) else None
    if known is None or not isinstance(given, str):
        raise InputError(
            f"{path}: no document of hiermap: its format key is {given!r}; known are "
            + ", ".join(FORMATS)
        )
    check_format(path, document, given, known.version)
    kind = f"{given} {'.'.join(map(str, document['version']))}"
    shape, faults = shape_faults(document, known.shape)
    if shape is not None:
        faults = known.semantics(shape)
    if not faults and given == "hiermap-reference":
        read_reference(path)
    return Verdict(kind, _limited(faults))


def _check_tum(path: Path) -> Verdict:
    read_tum(path)
    table = read_number_lines(path, 8, "t x y z qx qy qz qw")
    faults = _stamp_faults(table.stamps_ns[:, 0], table.line_numbers)
    norms = np.linalg.norm(table.values[:, 4:], axis=1)
    for index in np.flatnonzero(np.abs(norms - 1.0) > NORM_TOLERANCE)[:_MAX_LISTED]:
        line = table.line_numbers[index]
        faults.append(f"line {line}: the quaternion has length {norms[index]:.9g}, not 1")
    return Verdict("trajectory (TUM)", _limited(faults))


def _check_text(path: Path) -> Verdict:
    """Covariances have seven columns, relations eight."""
    columns = _columns(path)
    if columns == 8:
        return Verdict(f"relations ({len(read_relations(path).poses)})", [])
    if columns != 7:
        raise InputError(
            f"{path}: its first line has {columns} columns; the covariances of a trajectory have 7 "
            "(t xx xy xt yy yt tt), relations 8 (t1 t2 x y z roll pitch yaw)"
        )
    covariances = read_covariances(path)
    faults = _stamp_faults(covariances.stamps_ns, None)
    bad = first_bad_covariance(covariances.covariances)
    if bad is not None:
        t = stamp_text(int(covariances.stamps_ns[bad[0]]))
        faults.append(f"the covariance at t = {t} {bad[1]}")
    return Verdict("covariances of a trajectory", _limited(faults))


def _columns(path: Path) -> int:
    """Columns of the first line that is neither blank nor a comment; 0 where there is none."""
    try:
        with path.open(encoding="utf-8") as file:
            for line in file:
                words = line.split()
                if words and not words[0].startswith("#"):
                    return len(words)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})") from None
    return 0


def _stamp_faults(stamps_ns: NDArray[np.int64], lines: list[int] | None) -> list[str]:
    """Stamps that go back; equal ones are allowed, since a log may repeat a stamp."""
    back = np.flatnonzero(np.diff(stamps_ns) < 0) + 1
    faults = []
    for index in back[:_MAX_LISTED]:
        where = f"line {lines[index]}: " if lines else ""
        earlier, later = stamp_text(int(stamps_ns[index - 1])), stamp_text(int(stamps_ns[index]))
        faults.append(f"{where}the stamp {later} comes after {earlier}; stamps may not go back")
    return faults


def _limited(faults: list[str]) -> list[str]:
    more = len(faults) - _MAX_LISTED
    return faults if more <= 0 else [*faults[:_MAX_LISTED], f"and {more} more"]
