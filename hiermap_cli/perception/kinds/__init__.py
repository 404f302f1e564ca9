"""The kinds of landmarks: a table of rule sets, one file a kind (section 4, figures 3 to 5).

Every module of this package with a `RULES` is a row of the table, so that a new kind is one new
file and nothing else.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hiermap_cli.perception.kinds.rules import RuleSet


def rule_sets() -> tuple[RuleSet, ...]:
    """All rule sets, in the order in which they take their lines."""
    found: list[RuleSet] = []
    for module in pkgutil.iter_modules(__path__):
        rules = getattr(importlib.import_module(f"{__name__}.{module.name}"), "RULES", None)
        if rules is not None:
            found.append(rules)
    return tuple(sorted(found, key=lambda rules: (rules.rank, rules.kinds)))
