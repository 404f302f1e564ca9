"""JOBS.yaml: read as a whole, every fault listed, and unfolded into jobs, before any begins."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, TypeVar

from hiermap_cli.batch.job import EVALUATED_BY, ConfigChoice, Job
from hiermap_cli.batch.patterns import Found, find_logs, without_ending
from hiermap_cli.batch.quantities import parse_bytes, parse_seconds
from hiermap_cli.batch.remote import check_url, is_url
from hiermap_cli.config import Config
from hiermap_cli.configfile import fault_lines, load_config, read_with_lines
from hiermap_cli.documents.shapes import JobsDocument
from hiermap_cli.errors import ConfigurationError, UsageError
from hiermap_cli.evaluation.limits import parse_limit
from hiermap_cli.faults import Fault, KeyPath

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from hiermap_cli.documents.shapes import JobDefaults, JobShape

MAX_BYTES = 50_000_000  # ten thousand jobs of one line each are one or two million
MAX_NODES = 5_000_000
RESERVED = ("summary", "junit.xml")  # beginnings of the batch's own files in its folder
N = TypeVar("N", int, float)
_KEYS = ("config", *EVALUATED_BY, "limits", "time_limit", "memory_limit")


def read_jobs(path: Path) -> list[Job]:
    """The jobs of a file, in its order; a pattern's are sorted.

    In `reference`, `trajectory` and `relations`, `{folder}` stands for the log's folder and
    `{stem}` for its name without its ending, so that a pattern finds what belongs to each log.

    Raises:
        ConfigurationError: the file cannot be read or has faults: all are listed, with their
            line and path; those of the configurations that it names too.
    """
    path = Path(path)
    base = Path(os.path.abspath(path)).parent  # noqa: PTH100 - workers may stand elsewhere
    document, lines = read_with_lines(path, JobsDocument, max_bytes=MAX_BYTES, max_nodes=MAX_NODES)
    reader = _Reader(base, document.defaults, lines)
    jobs = [job for index, shape in enumerate(document.jobs) for job in reader.jobs(index, shape)]
    reader.check_names()
    if reader.faults:
        raise ConfigurationError(str(path), list(dict.fromkeys(fault_lines(reader.faults))))
    return jobs


class _Reader:
    """Unfolds the jobs of one file, and gathers every fault."""

    def __init__(self, base: Path, defaults: JobDefaults | None, lines: dict[KeyPath, int]) -> None:
        self._base = base
        self._defaults = defaults
        self._lines = lines
        self._configs: dict[str | None, ConfigChoice | None] = {}
        self._exists: dict[str, bool] = {}
        self._names: dict[str, tuple[KeyPath, str]] = {}
        self.faults: list[Fault] = []

    def jobs(self, index: int, shape: JobShape) -> list[Job]:
        """The jobs of one entry: every log with every configuration."""
        here: KeyPath = ("jobs", index)
        values, at = self._with_defaults(here, shape)
        self._check_name(shape.name, (*here, "name"))
        limits = self._limits(values["limits"], at["limits"])
        time_limit = self._parsed(parse_seconds, values["time_limit"], at["time_limit"])
        memory_limit = self._parsed(parse_bytes, values["memory_limit"], at["memory_limit"])
        logs = self._logs(shape.log, (*here, "log"))
        configs = self._config_choices(values["config"], at["config"])
        out = []
        for found in logs:
            files = {role: self._file(values[role], found, at[role]) for role in EVALUATED_BY}
            for stem, config in configs:
                name = "/".join(part for part in (shape.name, found.suffix, stem) if part)
                self._note_name(name, here, found.log)
                if config is not None:
                    out.append(
                        Job(
                            name,
                            found.log,
                            config,
                            limits=limits,
                            time_limit=time_limit,
                            memory_limit=memory_limit,
                            **files,
                        )
                    )
        return out

    def _with_defaults(
        self, here: KeyPath, shape: JobShape
    ) -> tuple[dict[str, Any], dict[str, KeyPath]]:
        """Each key's value, the job's own before the defaults', and where it is written.

        A key that a job sets to null has no value, whatever the defaults say.
        """
        values, at = {}, {}
        for key in _KEYS:
            own = key in shape.model_fields_set or self._defaults is None
            values[key] = getattr(shape if own else self._defaults, key)
            at[key] = (*here, key) if own else ("defaults", key)
        return values, at

    def _logs(self, given: str | list[str], at: KeyPath) -> list[Found]:
        try:
            for one in [given] if isinstance(given, str) else given:
                if is_url(one):
                    check_url(one)
            return find_logs(given, self._base)
        except ValueError as error:
            self._fault(at, str(error))
            return []

    def _config_choices(
        self, given: str | list[str] | None, at: KeyPath
    ) -> list[tuple[str, ConfigChoice | None]]:
        """What each configuration adds to a name, and the configuration; None for a bad one."""
        if given is None or isinstance(given, str):
            return [("", self._config(given, at))]
        if not given:
            self._fault(at, "is an empty list; name at least one configuration, or leave it out")
        return [
            (PurePosixPath(one).stem, self._config(one, (*at, index)))
            for index, one in enumerate(given)
        ]

    def _config(self, given: str | None, at: KeyPath) -> ConfigChoice | None:
        if given not in self._configs:
            try:
                config = load_config(self._base / given) if given is not None else Config()
            except ConfigurationError as error:
                for fault in error.faults:
                    self._fault(at, f"{given}: {fault}")
                self._configs[given] = None
            else:
                self._configs[given] = choice_of(config)
        return self._configs[given]

    def _limits(self, given: Sequence[str] | None, at: KeyPath) -> tuple[str, ...]:
        limits = []
        for index, text in enumerate(given or ()):
            try:
                limits.append(parse_limit(text).text)
            except UsageError as error:
                self._fault((*at, index), str(error))
        return tuple(limits)

    def _parsed(
        self, parse: Callable[[float | str], N], given: float | str | None, at: KeyPath
    ) -> N | None:
        if given is None:
            return None
        try:
            return parse(given)
        except ValueError as error:
            self._fault(at, str(error))
            return None

    def _file(self, given: str | None, found: Found, at: KeyPath) -> str | None:
        """The path of a file to evaluate by, which must be there."""
        if given is None:
            return None
        if is_url(given):
            self._fault(at, "is an address; only logs are fetched, copy the file here")
            return None
        folder, _, last = found.log.rpartition("/")
        if is_url(found.log) and "{folder}" in given:
            self._fault(at, "{folder} is the log's, and the log is not here but at an address")
            return None
        filled = given.replace("{folder}", folder).replace("{stem}", without_ending(last))
        path = str(self._base / filled)
        if path not in self._exists:
            self._exists[path] = Path(path).is_file()
        if not self._exists[path]:
            self._fault(at, f"{filled}: no such file")
        return path

    def _check_name(self, name: str, at: KeyPath) -> None:
        parts = name.split("/")
        if any(part in ("", ".", "..") for part in parts):
            self._fault(at, f"{name!r} is no name of a folder below the batch's")
        elif name.startswith(".") or name.startswith(RESERVED):
            self._fault(at, f"{name!r} is kept for the batch's own files")
        elif not name.isprintable() or any(len(part.encode()) > 200 for part in parts):
            self._fault(at, f"{name[:50]!r} has control characters or is too long for a folder")

    def _note_name(self, name: str, here: KeyPath, log: str) -> None:
        """Remembers a job's name, and finds one that was there before."""
        if name in self._names:
            at, other = self._names[name]
            line = self._lines.get((*at, "name"), 0)
            if at != here:
                why = f"the other is in line {line}"
            elif other != log:
                why = f"{other} and {log}"
            else:
                why = "two configurations have one stem"
            self._fault((*here, "name"), f"two jobs are called {name} ({why})")
            return
        self._names[name] = here, log
        if len(name.encode()) > 2000 or not name.isprintable():
            self._fault((*here, "log"), f"{log!r} gives no name for a folder")

    def check_names(self) -> None:
        """No job's folder may lie in that of another."""
        for name, (here, _) in self._names.items():
            for parent in PurePosixPath(name).parents:
                other = self._names.get(str(parent))
                if other is not None:
                    line = self._lines.get((*other[0], "name"), 0)
                    self._fault(
                        (*here, "name"),
                        f"the results of {name} would lie in those of {parent} (line {line})",
                    )

    def _fault(self, at: KeyPath, message: str) -> None:
        known = at
        while known and known not in self._lines:
            known = known[:-1]
        self.faults.append(Fault(self._lines.get(known, 0), at, message))


def choice_of(config: Config) -> ConfigChoice:
    """A configuration as jobs carry it."""
    values = config.model_dump(mode="json")
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return ConfigChoice(values, hashlib.sha256(text.encode()).hexdigest())
