"""Limits in a YAML file: `limits: ["ate_rmse<=0.10", ...]`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict

from hiermap_cli.configfile import read_yaml
from hiermap_cli.errors import ConfigurationError, UsageError
from hiermap_cli.evaluation.limits import parse_limit

if TYPE_CHECKING:
    from pathlib import Path

    from hiermap_cli.evaluation.limits import Limit


class LimitsShape(BaseModel):
    """A file of limits: a list of texts, each as `--limit` takes it."""

    model_config = ConfigDict(extra="forbid")

    limits: list[str]


def read_limits(path: Path) -> list[Limit]:
    """The limits of a file.

    Raises:
        ConfigurationError: the file cannot be read, or has faults; all of them are listed.
    """
    limits, faults = [], []
    for i, text in enumerate(read_yaml(path, LimitsShape).limits):
        try:
            limits.append(parse_limit(text))
        except UsageError as error:
            faults.append(f"limits[{i}]: {error}")
    if faults:
        raise ConfigurationError(str(path), faults)
    return limits
