"""The JSON Schemas (draft 2020-12) of the documents, made from their shapes.

The files in `schemas/` are what `schema_text` gives, for programs that have no hiermap; a test
holds them equal, `make schemas` writes them anew.
"""

from __future__ import annotations

import json
from importlib import resources
from typing import TYPE_CHECKING, Any

from hiermap_cli.documents import shapes

if TYPE_CHECKING:
    from collections.abc import Mapping

DIALECT = "https://json-schema.org/draft/2020-12/schema"

SHAPES: Mapping[str, type[shapes.Shape]] = {
    "model": shapes.ModelDocument,
    "report": shapes.ReportDocument,
    "eval": shapes.EvalDocument,
    "reference": shapes.ReferenceDocument,
    "summary": shapes.SummaryDocument,
    "jobs": shapes.JobsDocument,
}


def schema_text(name: str) -> str:
    """The schema of a document of `SHAPES`, made from its shape.

    Raises:
        KeyError: there is no such document.
    """
    shape = SHAPES[name]
    schema = _without_titles(shape.model_json_schema())
    head = {"$schema": DIALECT, "$id": f"urn:hiermap:{name}:1"}
    return json.dumps(head | schema, indent=2) + "\n"


def _without_titles(schema: Any) -> Any:
    """The schema without the titles that only repeat the names of keys."""
    if isinstance(schema, list):
        return [_without_titles(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {key: value for key, value in schema.items() if not _is_title(key, value)}
    return {key: _without_titles(value) for key, value in kept.items()}


def _is_title(key: str, value: Any) -> bool:
    return key == "title" and isinstance(value, str)  # a property named title has a schema


def shipped_schema(name: str) -> str:
    """The schema file of a document as it is shipped with the package."""
    folder = resources.files("hiermap_cli.documents") / "schemas"
    return (folder / f"{name}.json").read_text(encoding="utf-8")
