"""Runs of logs and worlds under many configurations, several at once, none made twice.

Figures of runs are kept in out/variants, by the program's sources and the configuration: what has
been made is not made again, whoever asks, and a table that was interrupted goes on where it was.
A configuration that differs only in what comes after the filter shares the filter's run.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hiermap_cli.config import Config

sys.path.insert(0, str(Path(__file__).parent))
from runs import DATA, REAL_LOGS, ROOT, Source, Watched, judged, opened

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from hiermap_cli.mapping.model import MapResult

Figures = dict[str, Any]

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
LOGS_KEPT = 3  # by each worker
AFTER_THE_FILTER = ("loops", "refine")  # sections that the filter does not read


class Variant(NamedTuple):
    """One run: a log or world by its name, the seed of a world, and the configuration."""

    log: str
    config: Config
    seed: int = 0


def present(logs: Sequence[str]) -> list[str]:
    """The logs that are here; says of each other one that it is skipped."""
    here = [log for log in logs if log not in REAL_LOGS or (DATA / REAL_LOGS[log].log).exists()]
    for log in logs:
        if log not in here:
            sys.stderr.write(f"{log}: skipped, its log is not in ../shared/data\n")
    return here


def folder() -> Path:
    """Where the figures of runs of the program as it is now are kept."""
    return ROOT / "out" / "variants" / program()


def program() -> str:
    """A digest of the program and of what judges it."""
    digest = hashlib.sha256()
    sources = (ROOT / "hiermap_cli").rglob("*.py"), Path(__file__).parent.glob("runs.py")
    for path in sorted(path for some in sources for path in some):
        digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes() + b"\0")
    for path in sorted((ROOT / "datasets").glob("*.yaml")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def place(variant: Variant, kept: Path) -> Path:
    """The file in a folder in which a run's figures are kept."""
    told = json.dumps(variant.config.model_dump(mode="json"), sort_keys=True)
    digest = hashlib.sha256(told.encode()).hexdigest()[:16]
    return kept / f"{variant.log}-{variant.seed}-{digest}.json"


def kept_figures(variant: Variant, kept: Path) -> Figures | None:
    """A run's figures if it was made before."""
    path = place(variant, kept)
    if not path.exists():
        return None
    figures: Figures = json.loads(path.read_text())
    return figures


def make(variant: Variant, kept: Path) -> Figures:
    """A run's figures, made and kept. A run that fails has `fault` for its reason."""
    try:
        result = mapped(variant)
        figures = judged(_source(variant.log, variant.seed), result)
    except Exception as fault:  # noqa: BLE001 - what a configuration breaks is told in the table
        figures = {"fault": f"{type(fault).__name__}: {fault}"}
    path = place(variant, kept)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(figures))
    part.rename(path)
    return figures


def mapped(variant: Variant) -> MapResult:
    """The map; the filter's run is shared where the configuration is the default one up to it."""
    from hiermap_cli.mapping.run import finish, map_log

    source = _source(variant.log, variant.seed)
    if not shares_the_filter(variant.config):
        return map_log(source.watched, variant.config)
    mapper, laser_x = pickle.loads(_filtered(variant.log, variant.seed))
    mapper.config = variant.config
    return finish(mapper, {}, laser_x)


def shares_the_filter(config: Config) -> bool:
    """Whether the filter does with it what it does with the default configuration."""
    default = Config()
    same = {name: getattr(default, name) for name in AFTER_THE_FILTER}
    return config.refine.enabled and config.model_copy(update=same) == default


@lru_cache(maxsize=LOGS_KEPT)
def _source(log: str, seed: int) -> Source:
    source = opened(log, Config(), seed)
    return source._replace(watched=Watched(list(source.watched)))


@lru_cache(maxsize=LOGS_KEPT)
def _filtered(log: str, seed: int) -> bytes:
    from hiermap_cli.mapping.filtering import run_filter

    mounts = [block.mount.x for block in _source(log, seed).watched]
    return pickle.dumps((run_filter(_source(log, seed).watched, Config())[0], mounts[0]))


def make_all(
    variants: Sequence[Variant],
    told: Callable[[int, Variant, Figures], None],
    at_once: int = 2,
    kept: Path | None = None,
) -> list[Figures]:
    """The figures of all variants, in their order; `told` of each one when it is there.

    A worker keeps the logs that it had last: of many, those of one should stand together.
    """
    kept = kept or folder()
    old = {i: figures for i, one in enumerate(variants) if (figures := kept_figures(one, kept))}
    for n, (i, figures) in enumerate(old.items(), 1):
        told(n, variants[i], figures)
    made = dict(old)
    os.environ.update(ONE_THREAD)  # for the workers, which are started anew
    with ProcessPoolExecutor(at_once, mp_context=get_context("spawn")) as pool:
        jobs = {pool.submit(make, v, kept): i for i, v in enumerate(variants) if i not in old}
        for job in as_completed(jobs):
            i = jobs[job]
            made[i] = job.result()
            told(len(made), variants[i], made[i])
    return [made[i] for i in range(len(variants))]
