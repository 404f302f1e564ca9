"""The configuration as commented YAML: what `hiermap config` prints.

Every comment comes from the description of the field in `config`, so that there is one place to
read and to change. Reading the text back gives the same configuration.
"""

from __future__ import annotations

import re
import textwrap
import types
import typing
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from hiermap_cli.config import Config

_WIDTH = 100
_WORDS_OF_YAML = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}
_LIMITS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
_PLAIN = re.compile(r"[A-Za-z_/][A-Za-z0-9_/.-]*")


def config_text(config: Config) -> str:
    """`config` as YAML, a comment before every key."""
    head = [
        "# Configuration of `hiermap run`. Every key is optional; what is left out has the value",
        "# shown here. Lengths are metres, angles radians, times seconds.",
        "",
    ]
    lines = [*head, *_section(config, indent=0)]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _section(section: BaseModel, indent: int) -> list[str]:
    lines: list[str] = []
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        model = _model_of(field)
        about = field.description or ((model.__doc__ or "").strip() if model else "")
        if lines and (indent == 0 or isinstance(value, BaseModel)):
            lines.append("")
        lines += _comment(" ".join(part for part in (about, _bounds(field)) if part), indent)
        pad = " " * indent
        if isinstance(value, BaseModel):
            lines.append(f"{pad}{name}:")
            lines += _section(value, indent + 2)
        else:
            lines.append(f"{pad}{name}: {_value(value)}")
            if value is None and model is not None:
                lines += [f"{pad}# {line}" for line in _section_sketch(name, model)]
    return lines


def _section_sketch(name: str, model: type[BaseModel]) -> list[str]:
    """A section that is null by default, for a person to uncomment."""
    lines = [f"{name}:"]
    for key, field in model.model_fields.items():
        default = "..." if field.is_required() else _value(field.get_default())
        lines.append(f"  {key}: {default}  # {field.description or ''}")
    return lines


def _comment(text: str, indent: int) -> list[str]:
    text = " ".join(text.split())
    return textwrap.wrap(
        text, _WIDTH, initial_indent=" " * indent + "# ", subsequent_indent=" " * indent + "# "
    )


def _model_of(field: FieldInfo) -> type[BaseModel] | None:
    for leaf in _alternatives(field.annotation):
        if isinstance(leaf, type) and issubclass(leaf, BaseModel):
            return leaf
    return None


def _alternatives(annotation: Any) -> list[Any]:
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return list(typing.get_args(annotation))
    return [annotation]


def _bounds(field: FieldInfo) -> str:
    """The values that a key allows: its choices or its limits, in brackets."""
    parts = [
        "one of " + ", ".join(map(_value, typing.get_args(leaf)))
        for leaf in _alternatives(field.annotation)
        if typing.get_origin(leaf) is typing.Literal
    ]
    for limit in field.metadata:
        for name, words in _LIMITS.items():
            bound = getattr(limit, name, None)
            if bound is not None:
                parts.append(f"{words} {_value(bound)}")
    return f"[{', '.join(parts)}]" if parts else ""


def _value(value: Any) -> str:
    """A YAML 1.2 value; numbers with an exponent get a point, so that YAML 1.1 reads them too."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        text = repr(value)
        return text if "e" not in text or "." in text else text.replace("e", ".0e")
    if isinstance(value, int):
        return str(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_value(k)}: {_value(v)}" for k, v in value.items()) + "}"
    text = str(value)
    plain = _PLAIN.fullmatch(text) and text.lower() not in _WORDS_OF_YAML
    return text if plain else _quoted(text)


def _quoted(text: str) -> str:
    """A double-quoted YAML scalar."""
    return '"' + "".join(_escaped(c) for c in text) + '"'


def _escaped(c: str) -> str:
    if c in '"\\':
        return "\\" + c
    return c if c.isprintable() else f"\\U{ord(c):08x}"
