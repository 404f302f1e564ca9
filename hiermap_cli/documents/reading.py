"""Reading of JSON documents: text, format, version and shape, each fault in one line."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pydantic_core
from pydantic import ValidationError

from hiermap_cli.errors import InputError
from hiermap_cli.faults import faults_of, path_text

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hiermap_cli.documents.shapes import Shape
    from hiermap_cli.faults import KeyPath

    S = TypeVar("S", bound=Shape)

_SHOWN = 5  # faults named in one line; the rest are counted


def read_json(path: Path, *, finite: bool = True) -> Any:
    """The value of a JSON file, without NaN or infinity unless `finite` is False.

    Raises:
        InputError: the file cannot be read, is no JSON, or holds a number that is not finite.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    if not data.strip():
        raise InputError(f"{path}: is empty")
    try:
        return pydantic_core.from_json(data, allow_inf_nan=False)
    except ValueError as error:
        reason = re.sub(r"\s+", " ", str(error))
    try:
        value = pydantic_core.from_json(data)
    except ValueError:
        raise InputError(f"{path}: is no JSON ({reason})") from None
    if finite:
        raise InputError(f"{path}: {joined(infinite(value)) or f'is no JSON ({reason})'}")
    return value


def infinite(value: Any, place: KeyPath = ()) -> list[str]:
    """Every number of a JSON value that is NaN or infinite, which JSON has no word for."""
    if isinstance(value, float):
        if math.isfinite(value):
            return []
        return [f"{path_text(place) or 'the document'}: is {value}, not a finite number"]
    items: Iterable[tuple[str | int, Any]] = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    return [fault for key, item in items for fault in infinite(item, (*place, key))]


def check_format(path: Path, document: Any, wanted: str, version: tuple[int, int]) -> None:
    """Whether `document` is of the format and of a major version that this program reads.

    Raises:
        InputError: it is not.
    """
    given = document.get("format") if isinstance(document, dict) else None
    if given != wanted:
        said = f"says format {given!r}" if given is not None else "has no format key"
        raise InputError(f"{path}: is no {wanted} document: it {said}")
    number = document.get("version")
    if not (isinstance(number, list) and number and isinstance(number[0], int)):
        raise InputError(f"{path}: its version is {number!r}; expected [major, minor]")
    if number[0] > version[0]:
        text = ".".join(map(str, number))
        raise InputError(
            f"{path}: is {wanted} {text}, newer than this program knows ({version[0]}.x); "
            "read it with a newer hiermap"
        )
    if number[0] < version[0]:
        raise InputError(f"{path}: is {wanted} {number[0]}.x; this program reads {version[0]}.x")


def shape_faults(document: Any, shape: type[Shape]) -> tuple[Shape | None, list[str]]:
    """The document as its shape, or None and every fault with its path."""
    try:
        return shape.model_validate(document), []
    except ValidationError as error:
        return None, [fault.text() for fault in faults_of(error, shape)]


def joined(faults: list[str]) -> str:
    """Some faults in one line."""
    more = len(faults) - _SHOWN
    return "; ".join(faults[:_SHOWN]) + (f"; and {more} more" if more > 0 else "")


def read_shape(path: Path, shape: type[S], wanted: str, version: tuple[int, int]) -> S:
    """A JSON document as its shape.

    Raises:
        InputError: unreadable, of another format, of a newer major version, or not of the shape.
    """
    document = read_json(path)
    check_format(path, document, wanted, version)
    read, faults = shape_faults(document, shape)
    if not isinstance(read, shape):
        raise InputError(f"{path}: not a valid {wanted} document: {joined(faults)}")
    return read
