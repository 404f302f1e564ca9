"""What a batch costs beside its runs: time a job, memory of the parent. `make bench` notes them."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from batch_cases import jobs_of, small_log

from hiermap_cli.batch.batch import Options, View, run_batch
from hiermap_cli.batch.jobs_file import read_jobs
from hiermap_cli.batch.memory import resident_bytes, settle_in
from hiermap_cli.batch.run_log import run_log
from hiermap_cli.config import Config

pytestmark = pytest.mark.bench
JOBS = 2000


class Watching(View):
    """Notes the parent's memory as jobs end."""

    def __init__(self) -> None:
        self.held: list[int] = []

    def finished(self, outcome):
        assert outcome.status == "done", outcome
        self.held.append(resident_bytes(os.getpid()))


def tiny_jobs(folder: Path) -> Path:
    logs = [small_log(folder / f"n{index:04d}.log", turn=index) for index in range(JOBS)]
    return jobs_of(logs, folder / "jobs.yaml")


def test_two_thousand_tiny_jobs(benchmark, tmp_path):
    """A batch of one worker against the bare run of the same logs, one after the other, warm."""
    jobs = read_jobs(tiny_jobs(tmp_path))
    view = Watching()
    view_of_resume = Watching()

    def bare(place: Path) -> float:
        config = Config()
        run_log([Path(jobs[0].log)], config, place / "warm")
        settle_in()
        begin = time.perf_counter()
        for job in jobs[::10]:
            run_log([Path(job.log)], config, place / job.name)
        return (time.perf_counter() - begin) / len(jobs[::10])

    before = bare(tmp_path / "before")
    benchmark.pedantic(
        lambda: run_batch(jobs, tmp_path / "out", Options(workers=1), view), rounds=1
    )
    after = bare(tmp_path / "after")
    each = benchmark.stats.stats.total / JOBS
    begin = time.perf_counter()
    run_batch(jobs, tmp_path / "out", Options(workers=1), view_of_resume)
    benchmark.extra_info |= {
        "jobs": JOBS,
        "bare_run_ms": 1e3 * (before + after) / 2,
        "batch_ms_per_job": 1e3 * each,
        "added_ms_per_job": 1e3 * (each - (before + after) / 2),
        "parent_megabytes_after_100_jobs": view.held[99] / 1e6,
        "parent_megabytes_after_all_jobs": view.held[-1] / 1e6,
        "resume_ms_per_job": 1e3 * (time.perf_counter() - begin) / JOBS,
    }
