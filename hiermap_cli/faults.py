"""Faults of documents and configurations: a path, a line, and a few words of our own.

Pydantic finds what is wrong; this says it as a person would want to read it.
"""

from __future__ import annotations

import difflib
import types
import typing
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import BaseModel, ValidationError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pydantic_core import ErrorDetails

KeyPath = tuple[str | int, ...]


class Fault(NamedTuple):
    """A fault of a document: line (from 1, 0 if unknown), path of its key, and what is wrong."""

    line: int
    path: KeyPath
    message: str

    def text(self) -> str:
        """`line 12: segmentation.min_points: ...`."""
        parts = [f"line {self.line}"] if self.line else []
        if self.path:
            parts.append(path_text(self.path))
        return ": ".join([*parts, self.message])


def path_text(path: Iterable[str | int]) -> str:
    """`jobs[2].limits[0]`."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def faults_of(
    error: ValidationError, shape: type[BaseModel], lines: Mapping[KeyPath, int] | None = None
) -> list[Fault]:
    """Each fault that pydantic found in a `shape`, with its path, and its line where known."""
    faults = [
        Fault(0, tuple(details["loc"]), _message(details, shape))
        for details in error.errors(include_url=False)
    ]
    return with_lines(faults, lines or {})


def with_lines(faults: Iterable[Fault], lines: Mapping[KeyPath, int]) -> list[Fault]:
    """The faults with the line of their key, or of the nearest that it stands under."""
    found = []
    for fault in faults:
        known = fault.path
        while known and known not in lines:
            known = known[:-1]
        found.append(fault._replace(line=lines.get(known, 0)))
    return found


def _message(details: ErrorDetails, shape: type[BaseModel]) -> str:
    """One fault in a few words, with the value that was given."""
    kind, given = details["type"], details["input"]
    if kind == "extra_forbidden":
        *path, key = details["loc"]
        near = difflib.get_close_matches(str(key), _keys_at(shape, path), n=1)
        return "unknown key" + (f"; did you mean {near[0]}?" if near else "")
    if kind == "missing":
        return "is missing"
    if kind == "value_error":  # of a validator of ours
        return str(details["ctx"]["error"])
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"must be a section of keys and values, not {_shown(given)}"
    if kind in ("too_short", "too_long"):
        bound = "least" if kind == "too_short" else "most"
        number = details["ctx"]["min_length" if kind == "too_short" else "max_length"]
        entries = "entry" if number == 1 else "entries"
        return f"must have at {bound} {number} {entries}, not {details['ctx']['actual_length']}"
    message = details["msg"]
    message = message[0].lower() + message[1:]
    return f"{message}, not {_shown(given)}"


def _shown(given: Any) -> str:
    shown = repr(given)
    return shown if len(shown) <= 60 else shown[:57] + "..."


def _keys_at(shape: type[BaseModel], path: Iterable[str | int]) -> list[str]:
    """The keys that a section may have, for a hint at a misspelt one."""
    models = [shape]
    for part in path:
        fields = [model.model_fields[part] for model in models if part in model.model_fields]
        if isinstance(part, str) and fields:
            models = [model for field in fields for model in _models_in(field.annotation)]
    return sorted({name for model in models for name in model.model_fields})


def _models_in(wanted: Any) -> list[type[BaseModel]]:
    """The models of an annotation, those of lists and tuples included."""
    found = []
    for leaf in leaves(wanted):
        if is_model(leaf):
            found.append(leaf)
        for part in typing.get_args(leaf):
            found += _models_in(part)
    return found


def leaves(wanted: Any) -> list[Any]:
    """The alternatives of an annotation: unions opened, Annotated removed, Literals opened."""
    origin = typing.get_origin(wanted)
    if origin is typing.Annotated:
        return leaves(typing.get_args(wanted)[0])
    if origin in (typing.Union, types.UnionType):
        return [leaf for part in typing.get_args(wanted) for leaf in leaves(part)]
    if origin is typing.Literal:
        return [type(value) for value in typing.get_args(wanted)]
    return [wanted]


def is_model(leaf: Any) -> bool:
    """Whether an alternative of an annotation is a pydantic model."""
    return isinstance(leaf, type) and issubclass(leaf, BaseModel)
