"""Limits in a YAML file: `limits: ["ate_rmse<=0.10", ...]`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict

from hiermap_cli.configfile import fault_lines, read_with_lines
from hiermap_cli.errors import ConfigurationError, UsageError
from hiermap_cli.evaluation.limits import parse_limit
from hiermap_cli.faults import Fault, with_lines

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
    shape, lines = read_with_lines(path, LimitsShape)
    for i, text in enumerate(shape.limits):
        try:
            limits.append(parse_limit(text))
        except UsageError as error:
            faults.append(Fault(0, ("limits", i), str(error)))
    if faults:
        raise ConfigurationError(str(path), fault_lines(with_lines(faults, lines)))
    return limits
