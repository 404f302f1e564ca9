"""YAML files read strictly into pydantic models: every fault at once, with its path and line.

PyYAML's own resolution is that of YAML 1.1 and is not used: it reads `1e-3` as text, `no` as
False, `1:30` as ninety, and lets a repeated key win. Here the document is only composed into
nodes, and each plain scalar is read as what the model wants at its place: text stays text for a
key of text, `yes`/`no`/`on`/`off` are booleans for a key of booleans alone, and numbers are
those of YAML 1.2 and JSON. Values that do not fit are left as they are for pydantic to refuse.
"""

from __future__ import annotations

import re
import types
import typing
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from hiermap_cli.config import Config
from hiermap_cli.errors import ConfigurationError
from hiermap_cli.faults import Fault, KeyPath, faults_of, is_model, leaves, path_text

if TYPE_CHECKING:
    from collections.abc import Iterable

_INTEGER = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = {".inf": "inf", "+.inf": "inf", "-.inf": "-inf", ".nan": "nan"}
_NULLS = {"", "~", "null", "Null", "NULL"}
_TRUE = {"true", "yes", "on"}
_FALSE = {"false", "no", "off"}
MAX_BYTES = 1_000_000
MAX_NODES = 200_000  # after aliases are followed: a bomb of anchors ends here

M = TypeVar("M", bound=BaseModel)


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
    return parse_yaml(_read_text(Path(path)), str(path), shape)


def top_keys(path: Path) -> dict[str, type]:
    """The keys at the top of a YAML file and what is under them: dict, list or str.

    To tell one kind of file from another.

    Raises:
        ConfigurationError: the file cannot be read, or is no YAML.
    """
    node = _compose(_read_text(Path(path)), str(path))
    if not isinstance(node, yaml.MappingNode):
        return {}
    kinds = {yaml.MappingNode: dict, yaml.SequenceNode: list, yaml.ScalarNode: str}
    return {str(key.value): kinds[type(value)] for key, value in node.value}


def _read_text(path: Path, max_bytes: int = MAX_BYTES) -> str:
    """The text of a file.

    Raises:
        ConfigurationError: it cannot be read, is no UTF-8, or is larger than any of ours.
    """
    try:
        if path.stat().st_size > max_bytes:
            raise ConfigurationError(str(path), [f"is larger than {max_bytes} bytes"])
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        fault = f"is no UTF-8 text (byte {error.start}); a YAML file in UTF-8 is expected"
        raise ConfigurationError(str(path), [fault]) from None
    except OSError as error:
        raise ConfigurationError(
            str(path), [f"cannot be read ({error.strerror or error})"]
        ) from None


def parse_yaml(text: str, source: str, shape: type[M]) -> M:
    """YAML text as the model `shape`; `source` names it in messages. An empty text is `{}`.

    Raises:
        ConfigurationError: the text has faults; all of them are listed.
    """
    return parse_with_lines(text, source, shape)[0]


def read_with_lines(
    path: Path, shape: type[M], *, max_bytes: int = MAX_BYTES, max_nodes: int = MAX_NODES
) -> tuple[M, dict[KeyPath, int]]:
    """A YAML file as the model `shape`, and the line of every key and item, by its path.

    For those who find faults that no shape can tell, and want to say where they are. A file
    larger than `max_bytes`, or with more nodes than `max_nodes`, is none of this shape.

    Raises:
        ConfigurationError: the file cannot be read, or has faults; all of them are listed.
    """
    text = _read_text(Path(path), max_bytes)
    return parse_with_lines(text, str(path), shape, max_nodes=max_nodes)


def parse_with_lines(
    text: str, source: str, shape: type[M], *, max_nodes: int = MAX_NODES
) -> tuple[M, dict[KeyPath, int]]:
    """As `parse_yaml`, with the line of every key and item, by its path.

    Raises:
        ConfigurationError: the text has faults; all of them are listed.
    """
    node = _compose(text, source)
    if node is None:
        return parse_with_lines("{}", source, shape)
    if not isinstance(node, yaml.MappingNode):
        line = node.start_mark.line + 1
        raise ConfigurationError(source, [f"line {line}: must hold keys with values, key: value"])
    _check_other(node, source, shape)
    builder = _Builder(max_nodes)
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
            faults += faults_of(error, shape, builder.lines)
        else:
            if not faults:
                return checked, builder.lines
    raise ConfigurationError(source, fault_lines(faults))


def _check_other(node: yaml.MappingNode, source: str, shape: type[BaseModel]) -> None:
    """One fault for a file that says itself that it is another document, not one for every key.

    Raises:
        ConfigurationError: it has a key `format`, which `shape` does not know.
    """
    if "format" in shape.model_fields:
        return
    for key, value in node.value:
        if key.value == "format" and str(value.value).startswith("hiermap-"):
            line = f"line {key.start_mark.line + 1}"
            fault = f"{line}: is a {value.value} document; another kind of file is expected"
            raise ConfigurationError(source, [fault])


def fault_lines(faults: Iterable[Fault]) -> list[str]:
    """The faults as text, in the order of the file."""
    return [fault.text() for fault in sorted(faults, key=_by_line)]


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

    def __init__(self, max_nodes: int) -> None:
        self.lines: dict[KeyPath, int] = {}
        self.faults: list[Fault] = []
        self._nodes = 0
        self._max_nodes = max_nodes

    def build(self, node: yaml.Node, wanted: Any, path: KeyPath) -> Any:
        """The value of `node` where the annotation `wanted` is asked for."""
        self._nodes += 1
        if self._nodes > self._max_nodes:
            raise _TooLargeError
        self.lines[path] = node.start_mark.line + 1
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, wanted, path)
        if isinstance(node, yaml.SequenceNode):
            return self._sequence(node, wanted, path)
        kinds = leaves(wanted)
        if node.value in _NULLS and types.NoneType not in kinds and any(map(is_model, kinds)):
            return {}  # a section whose keys are all commented out
        return read_scalar(
            node.value, quoted=getattr(node, "style", None) is not None, wanted=kinds
        )

    def _mapping(self, node: yaml.MappingNode, wanted: Any, path: KeyPath) -> dict[str, Any]:
        model = next((leaf for leaf in leaves(wanted) if is_model(leaf)), None)
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

    def _sequence(self, node: yaml.SequenceNode, wanted: Any, path: KeyPath) -> Any:
        inner: Any = Any
        is_tuple = False
        for leaf in leaves(wanted):
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


def _field(model: type[BaseModel] | None, key: str, wanted: Any) -> Any:
    """The annotation of a mapping's value: of the model's field, or of the dict's values."""
    if model is not None:
        field = model.model_fields.get(key)
        return field.annotation if field is not None else Any
    for leaf in leaves(wanted):
        if typing.get_origin(leaf) is dict:
            return typing.get_args(leaf)[1]
    return Any


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
