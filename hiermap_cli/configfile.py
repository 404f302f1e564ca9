"""YAML files read strictly into pydantic models: every fault at once, with its path and line.

PyYAML's own resolution is that of YAML 1.1 and is not used: it reads `1e-3` as text, `no` as
False, `1:30` as ninety, and lets a repeated key win. Here the document is only composed into
nodes, and each plain scalar is read as what the model wants at its place: text stays text for a
key of text, `yes`/`no`/`on`/`off` are booleans for a key of booleans alone, and numbers are
those of YAML 1.2 and JSON. Values that do not fit are left as they are for pydantic to refuse.
"""

from __future__ import annotations

import difflib
import re
import types
import typing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from hiermap_cli.config import Config
from hiermap_cli.errors import ConfigurationError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pydantic_core import ErrorDetails

_INTEGER = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = {".inf": "inf", "+.inf": "inf", "-.inf": "-inf", ".nan": "nan"}
_NULLS = {"", "~", "null", "Null", "NULL"}
_TRUE = {"true", "yes", "on"}
_FALSE = {"false", "no", "off"}
_MAX_BYTES = 1_000_000
_MAX_NODES = 200_000  # after aliases are followed: a bomb of anchors ends here

Path_ = tuple[str | int, ...]
M = TypeVar("M", bound=BaseModel)


class Fault(NamedTuple):
    """A fault of a document: line (from 1, 0 if unknown), path of its key, and what is wrong."""

    line: int
    path: Path_
    message: str

    def text(self) -> str:
        """`line 12: segmentation.min_points: ...`."""
        parts = [f"line {self.line}"] if self.line else []
        if self.path:
            parts.append(path_text(self.path))
        return ": ".join([*parts, self.message])


def load_config(path: Path) -> Config:
    """The configuration in a YAML file; keys that it does not name have their defaults.

    Raises:
        ConfigurationError: the file cannot be read, or has faults; all of them are listed.
    """
    return read_yaml(path, Config)


def read_yaml(path: Path, shape: type[M]) -> M:
    """A YAML file as the model `shape`.

    Raises:
        ConfigurationError: the file cannot be read, or has faults; all of them are listed.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ConfigurationError(str(path), [f"is larger than {_MAX_BYTES} bytes"])
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigurationError(
            str(path), [f"is no UTF-8 text (byte {error.start}); save it as UTF-8"]
        ) from None
    except OSError as error:
        raise ConfigurationError(
            str(path), [f"cannot be read ({error.strerror or error})"]
        ) from None
    return parse_yaml(text, str(path), shape)


def parse_yaml(text: str, source: str, shape: type[M]) -> M:
    """YAML text as the model `shape`; `source` names it in messages. An empty text is `{}`.

    Raises:
        ConfigurationError: the text has faults; all of them are listed.
    """
    node = _compose(text, source)
    if node is None:
        return parse_yaml("{}", source, shape)
    if not isinstance(node, yaml.MappingNode):
        line = node.start_mark.line + 1
        raise ConfigurationError(source, [f"line {line}: must hold keys with values, key: value"])
    builder = _Builder()
    try:
        value = builder.build(node, shape, ())
    except (_TooLargeError, RecursionError):
        builder.faults.append(Fault(0, (), "its anchors and aliases unfold without end"))
        value = {}
    faults = list(builder.faults)
    if not faults or value:
        try:
            checked = shape.model_validate(value, strict=True)
        except ValidationError as error:
            faults += faults_of(error, builder.lines)
        else:
            if not faults:
                return checked
    raise ConfigurationError(source, [fault.text() for fault in sorted(faults, key=_by_line)])


def _by_line(fault: Fault) -> tuple[int, str]:
    return fault.line, path_text(fault.path)


def _compose(text: str, source: str) -> yaml.Node | None:
    """The nodes of the only document in `text`.

    Raises:
        ConfigurationError: the text is no YAML, or holds several documents.
    """
    try:
        node: yaml.Node | None = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 0
        problem = error.problem or error.context or "is no YAML"
        if "\\t" in problem:
            problem = "indented by a tab; YAML wants spaces"
        elif "but found another document" in problem:
            problem = "a second document begins (---); only one is read"
        raise ConfigurationError(source, [Fault(line, (), problem).text()]) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        message = f"a character that YAML does not allow (number {error.character})"
        raise ConfigurationError(source, [Fault(line, (), message).text()]) from None
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigurationError(source, [f"is no YAML ({error})"]) from None
    except RecursionError:
        raise ConfigurationError(source, ["is nested too deeply"]) from None
    return node


class _TooLargeError(Exception):
    """More nodes than any document of ours has."""


class _Builder:
    """Turns nodes into plain values, remembering the line of every path and each fault."""

    def __init__(self) -> None:
        self.lines: dict[Path_, int] = {}
        self.faults: list[Fault] = []
        self._nodes = 0

    def build(self, node: yaml.Node, wanted: Any, path: Path_) -> Any:
        """The value of `node` where the annotation `wanted` is asked for."""
        self._nodes += 1
        if self._nodes > _MAX_NODES:
            raise _TooLargeError
        self.lines[path] = node.start_mark.line + 1
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, wanted, path)
        if isinstance(node, yaml.SequenceNode):
            return self._sequence(node, wanted, path)
        leaves = _leaves(wanted)
        if node.value in _NULLS and types.NoneType not in leaves and any(map(_is_model, leaves)):
            return {}  # a section whose keys are all commented out
        return read_scalar(
            node.value, quoted=getattr(node, "style", None) is not None, wanted=leaves
        )

    def _mapping(self, node: yaml.MappingNode, wanted: Any, path: Path_) -> dict[str, Any]:
        model = next((leaf for leaf in _leaves(wanted) if _is_model(leaf)), None)
        out: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                self.faults.append(Fault(line, path, "a key must be a word"))
                continue
            key = str(key_node.value)
            here = (*path, key)
            if key in out:
                first = self.lines[here]
                self.faults.append(Fault(line, here, f"given twice (first in line {first})"))
                continue
            out[key] = self.build(value_node, _field(model, key, wanted), here)
            self.lines[here] = line
        return out

    def _sequence(self, node: yaml.SequenceNode, wanted: Any, path: Path_) -> Any:
        inner: Any = Any
        is_tuple = False
        for leaf in _leaves(wanted):
            arguments = typing.get_args(leaf)
            if typing.get_origin(leaf) in (list, tuple, set, frozenset) and arguments:
                inner, is_tuple = arguments, typing.get_origin(leaf) is tuple
        items = []
        for index, child in enumerate(node.value):
            if inner is Any:
                item_wanted = Any
            elif is_tuple and not (len(inner) == 2 and inner[1] is Ellipsis):
                item_wanted = inner[index] if index < len(inner) else Any
            else:
                item_wanted = inner[0]
            items.append(self.build(child, item_wanted, (*path, index)))
        return tuple(items) if is_tuple else items


def _is_model(leaf: Any) -> bool:
    return isinstance(leaf, type) and issubclass(leaf, BaseModel)


def _field(model: type[BaseModel] | None, key: str, wanted: Any) -> Any:
    """The annotation of a mapping's value: of the model's field, or of the dict's values."""
    if model is not None:
        field = model.model_fields.get(key)
        return field.annotation if field is not None else Any
    for leaf in _leaves(wanted):
        if typing.get_origin(leaf) is dict:
            return typing.get_args(leaf)[1]
    return Any


def _leaves(wanted: Any) -> list[Any]:
    """The alternatives of an annotation: unions opened, Annotated removed, Literals opened."""
    origin = typing.get_origin(wanted)
    if origin is typing.Annotated:
        return _leaves(typing.get_args(wanted)[0])
    if origin in (typing.Union, types.UnionType):
        return [leaf for part in typing.get_args(wanted) for leaf in _leaves(part)]
    if origin is typing.Literal:
        return [type(value) for value in typing.get_args(wanted)]
    return [wanted]


def read_scalar(text: str, *, quoted: bool, wanted: Iterable[Any]) -> Any:
    """A YAML scalar as one of the types `wanted`; what fits none is read by YAML 1.2 alone."""
    if quoted:
        return text
    kinds = set(wanted)
    anything = not kinds & {bool, int, float, str}
    if text in _NULLS and (types.NoneType in kinds or anything or str not in kinds):
        return None
    lower = text.lower()
    if bool in kinds and lower in _TRUE | _FALSE:
        return lower in _TRUE
    if str in kinds and not kinds & {int, float}:
        return text
    if _INTEGER.fullmatch(text) and len(text) < 300:
        return int(text)
    if _NUMBER.fullmatch(text) or lower in _SPECIAL:
        return float(_SPECIAL.get(lower, text))
    if lower in ("true", "false") and str not in kinds:
        return lower == "true"
    return text


# --- faults of pydantic, in our words ------------------------------------------------------------


def path_text(path: Iterable[str | int]) -> str:
    """`jobs[2].limits[0]`."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def faults_of(error: ValidationError, lines: Mapping[Path_, int] | None = None) -> list[Fault]:
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
            models += [leaf for leaf in _leaves(field.annotation) if _is_model(leaf)]
    return sorted(keys)


def _all_models(base: type[BaseModel]) -> list[type[BaseModel]]:
    out = [base]
    for child in base.__subclasses__():
        out += _all_models(child)
    return out
