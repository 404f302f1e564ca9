"""A job of a batch, and what became of it: the values that travel to a worker and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from hiermap_cli.batch.quantities import bytes_text

Status = Literal["done", "failed", "limit_missed"]
EVALUATED_BY = ("reference", "trajectory", "relations")


@dataclass(frozen=True, slots=True)
class ConfigChoice:
    """A configuration that jobs share.

    values: the effective configuration, defaults included. digest: SHA-256 of them, so that a
    comment or a key written out changes nothing.
    """

    values: dict[str, Any]
    digest: str


class Job(NamedTuple):
    """One log under one configuration.

    name: its folder below the batch's. log: a path or an URL. reference, trajectory, relations:
    paths, or None. limits: as `parse_limit` reads them. time_limit: seconds; memory_limit: bytes;
    None for what the batch says.
    """

    name: str
    log: str
    config: ConfigChoice
    reference: str | None = None
    trajectory: str | None = None
    relations: str | None = None
    limits: tuple[str, ...] = ()
    time_limit: float | None = None
    memory_limit: int | None = None

    @property
    def is_remote(self) -> bool:
        """Whether the log must be fetched first."""
        return "://" in self.log

    def inputs(self) -> dict[str, str]:
        """Every file that decides the result, by its part in the job."""
        files = {"log": self.log}
        for role in EVALUATED_BY:
            path = getattr(self, role)
            if path is not None:
                files[role] = path
        return files

    def to_json(self) -> dict[str, Any]:
        """The job as plain values."""
        config = {"values": self.config.values, "digest": self.config.digest}
        return {**self._asdict(), "config": config, "limits": list(self.limits)}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Job:
        """The job that `to_json` gave."""
        config = ConfigChoice(**values["config"])
        return cls(**{**values, "config": config, "limits": tuple(values["limits"])})


class Outcome(NamedTuple):
    """What became of a job.

    reason: why it failed, or which limits were missed. seconds: by the clock on the wall;
    peak_memory: bytes. kept: the result of an earlier batch, not done again. traceback: of a
    fault of the program.
    """

    name: str
    status: Status
    reason: str | None = None
    seconds: float | None = None
    peak_memory: int | None = None
    kept: bool = False
    traceback: str | None = None


def failed(
    name: str, reason: str, seconds: float | None = None, traceback: str | None = None
) -> Outcome:
    """The outcome of a job without a result."""
    return Outcome(name, "failed", reason, seconds, traceback=traceback)


def too_much_memory(limit: int | None) -> str:
    """The reason of a job that was refused memory."""
    return "needs more memory than it may have" + (
        f" (limit {bytes_text(limit)})" if limit is not None else ""
    )


def kept_outcome(name: str, row: dict[str, Any]) -> Outcome:
    """The outcome that a result's row tells of."""
    return Outcome(
        name, row["status"], row["reason"], row["seconds"], row["peak_memory"], kept=True
    )
