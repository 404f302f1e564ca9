"""Which document a file is, and whether it holds: shape and semantics, every fault listed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from hiermap_cli.documents import model_file, report_file, shapes
from hiermap_cli.documents.checks import first_bad_covariance
from hiermap_cli.documents.reading import check_format, infinite, read_json, shape_faults
from hiermap_cli.documents.reference import FORMAT as REFERENCE_FORMAT
from hiermap_cli.documents.reference import reference_faults
from hiermap_cli.documents.relations import RELATION_COLUMNS, read_relations
from hiermap_cli.documents.semantics import eval_faults, model_faults, report_faults
from hiermap_cli.documents.trajectories import read_covariances
from hiermap_cli.documents.tum import (
    TUM_COLUMNS,
    LineFault,
    looks_like_poses,
    looks_like_relations,
    read_number_lines,
    read_tum,
    stamp_faults,
    stamp_text,
    tum_faults,
)
from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_MAX_LISTED = 50
_MAX_LINES = 5  # of a table with the same fault in many


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
    REFERENCE_FORMAT: _Known((1, 0), shapes.ReferenceDocument, _nothing),
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
    document = read_json(path, finite=False)
    given = document.get("format") if isinstance(document, dict) else None
    known = _JSON.get(given) if isinstance(given, str) else None
    if known is None or not isinstance(given, str):
        its = "it has no format key" if given is None else f"its format key is {given!r}"
        raise InputError(f"{path}: no document of hiermap: {its}; known are {', '.join(FORMATS)}")
    check_format(path, document, given, known.version)
    kind = f"{given} {'.'.join(map(str, document['version']))}"
    # What eval refuses is said in eval's words; other documents hold no numbers that are none.
    faults = reference_faults(document) if given == REFERENCE_FORMAT else infinite(document)
    if not faults:
        shape, faults = shape_faults(document, known.shape)
        if shape is not None:
            faults = known.semantics(shape)
    return Verdict(kind, _limited(faults))


def _check_tum(path: Path) -> Verdict:
    table = read_number_lines(path, 8, TUM_COLUMNS)
    if looks_like_relations(table):
        read_tum(path)  # refuses them in the words of those who need a trajectory
    faults = tum_faults(table)
    turned = [fault for fault in faults if "quaternion" in fault.message]
    back = [fault for fault in faults if fault not in turned]
    return Verdict("trajectory (TUM)", [*_few(turned), *_few(back)])


def _check_text(path: Path) -> Verdict:
    """Covariances have seven columns, relations and poses eight."""
    columns = _columns(path)
    if columns == 8:
        if looks_like_poses(read_number_lines(path, 8, RELATION_COLUMNS)):
            return _check_tum(path)
        return Verdict(f"relations ({len(read_relations(path).poses)})", [])
    if columns != 7:
        raise InputError(
            f"{path}: its first line has {columns} columns; the covariances of a trajectory have 7 "
            "(t xx xy xt yy yt tt), relations 8 (t1 t2 x y z roll pitch yaw)"
        )
    covariances = read_covariances(path)
    faults = _few(stamp_faults(covariances.stamps_ns, covariances.line_numbers))
    bad = first_bad_covariance(covariances.covariances)
    if bad is not None:
        t = stamp_text(int(covariances.stamps_ns[bad[0]]))
        faults.append(f"the covariance at t = {t} {bad[1]}")
    return Verdict("covariances of a trajectory", faults)


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


def _few(faults: list[LineFault]) -> list[str]:
    """The first lines with a fault, and how many more have it."""
    more = len(faults) - _MAX_LINES
    listed = [f"line {fault.line}: {fault.message}" for fault in faults[:_MAX_LINES]]
    return listed if more <= 0 else [*listed, f"and {more} more lines with this fault"]


def _limited(faults: list[str]) -> list[str]:
    more = len(faults) - _MAX_LISTED
    return faults if more <= 0 else [*faults[:_MAX_LISTED], f"and {more} more"]
