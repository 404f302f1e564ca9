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


def faults_of(error: ValidationError, lines: Mapping[KeyPath, int] | None = None) -> list[Fault]:
    """Each fault that pydantic found, with its path, and its line where `lines` knows it."""
    lines = lines or {}
    faults = []
    for details in error.errors(include_url=False):
        path = tuple(details["loc"])
        known = path
        while known and known not in lines:
            known = known[:-1]
        faults.append(Fault(lines.get(known, 0), path, _message(details, error)))
    return faults


def _message(details: ErrorDetails, error: ValidationError) -> str:
    """One fault in a few words, with the value that was given."""
    kind, given = details["type"], details["input"]
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(
            str(details["loc"][-1]), _known_keys(error.title), n=1, cutoff=0.6
        )
        return "unknown key" + (f"; did you mean {near[0]}?" if near else "")
    if kind == "missing":
        return "is missing"
    if kind == "value_error":  # of a validator of ours
        return str(details["ctx"]["error"])
    message = details["msg"]
    message = message[0].lower() + message[1:]
    shown = repr(given)
    return f"{message}, not {shown if len(shown) <= 60 else shown[:57] + '...'}"


def _known_keys(title: str) -> list[str]:
    """Every key of the model named `title` and of those in it, for a hint at a misspelt one."""
    keys: set[str] = set()
    models = [model for model in _all_models(BaseModel) if model.__name__ == title]
    seen: set[type[BaseModel]] = set()
    while models:
        model = models.pop()
        if model in seen:
            continue
        seen.add(model)
        for name, field in model.model_fields.items():
            keys.add(name)
            models += _models_in(field.annotation)
    return sorted(keys)


def _models_in(wanted: Any) -> list[type[BaseModel]]:
    """The models of an annotation, those of lists and tuples included."""
    found = []
    for leaf in leaves(wanted):
        if is_model(leaf):
            found.append(leaf)
        for part in typing.get_args(leaf):
            found += _models_in(part)
    return found


def _all_models(base: type[BaseModel]) -> list[type[BaseModel]]:
    out = [base]
    for child in base.__subclasses__():
        out += _all_models(child)
    return out


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
