"""Logs named by paths and patterns: which there are, and what their jobs are called."""

from __future__ import annotations

import glob
import os
import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.batch.remote import expand_url, is_url, split_url

if TYPE_CHECKING:
    from collections.abc import Sequence

LOG_ENDINGS = (".gz", ".bz2", ".mcap", ".bag", ".db3", ".carmen", ".clf", ".log", ".txt", ".dat")
_MAGIC = re.compile(r"[*?\[]")


class Found(NamedTuple):
    """A log, and what is added to the name of its job: "" for a single path."""

    log: str
    suffix: str


def find_logs(given: str | Sequence[str], base: Path) -> list[Found]:
    """The logs that a path, a pattern or a list of them stands for, in the order of the list.

    Patterns know `*`, `?`, `[...]` and `**` for any number of folders; what they find is sorted.
    What exists under the very name given is no pattern. A list counts as one pattern: its fixed
    part is what all of its items have in common.

    Args:
        given: relative paths are relative to `base`.
        base: the folder of the jobs file.

    Raises:
        ValueError: a pattern finds nothing, or a place cannot be listed; the message says which.
    """
    if isinstance(given, str):
        if not _is_pattern(given, base):
            return [Found(_absolute(given, base), "")]
        return _named(_expand(given, base), _fixed_part(given, base))
    logs = [log for one in given for log in _expand(one, base)]
    if not logs:
        raise ValueError("is an empty list; name at least one log")
    return _named(logs, _common([_fixed_part(one, base) for one in given]))


def without_ending(name: str) -> str:
    """The last part of a log's path without `.mcap`, `.log.gz`, ... or any other one ending."""
    stem = PurePosixPath(name)
    while stem.suffix.lower() in LOG_ENDINGS:
        stem = stem.with_suffix("")
    return stem.name if stem.name != name else PurePosixPath(name).stem


def _is_pattern(given: str, base: Path) -> bool:
    if is_url(given):
        # `?` begins the query of an URL; what http serves cannot be listed.
        return not given.startswith("http") and bool(re.search(r"[*\[]", given))
    return bool(_MAGIC.search(given)) and not os.path.lexists(base / given)


def _expand(given: str, base: Path) -> list[str]:
    if not _is_pattern(given, base):
        return [_absolute(given, base)]
    if is_url(given):
        found = expand_url(given)
    else:
        # Not Path.glob: it follows no links below ** and knows no absolute patterns.
        names = glob.glob(given, root_dir=base, recursive=True)  # noqa: PTH207
        found = sorted(str(base / name) for name in names)
    if not found:
        raise ValueError(f"no log fits {given}")
    return found


def _absolute(given: str, base: Path) -> str:
    return given if is_url(given) else str(base / given)


def _parts(log: str) -> list[str]:
    """The parts of a path or URL that may be compared; an URL's query is left out."""
    if is_url(log):
        head, path = split_url(log)
        return [head, *PurePosixPath(path).parts]
    return list(PurePosixPath(os.path.abspath(log)).parts)  # noqa: PTH100 - links are left as they are


def _fixed_part(given: str, base: Path) -> list[str]:
    """The folders before the first one that a pattern leaves open; of a path, its folder."""
    parts = given.split("/")
    if not _is_pattern(given, base):
        return _parts(_absolute(given, base))[:-1]
    fixed = next(index for index, part in enumerate(parts) if _MAGIC.search(part))
    return _parts(_absolute("/".join(parts[:fixed]) or ("/" if parts[0] == "" else ""), base))


def _common(paths: list[list[str]]) -> list[str]:
    shortest = min(paths, key=len)
    for index, part in enumerate(shortest):
        if any(path[index] != part for path in paths):
            return shortest[:index]
    return shortest


def _named(logs: Sequence[str], fixed: list[str]) -> list[Found]:
    found = []
    for log in dict.fromkeys(logs):  # one that two patterns find is one log
        *folders, last = _parts(log)[len(fixed) :]
        found.append(Found(log, "/".join([*folders, without_ending(last)])))
    return found
