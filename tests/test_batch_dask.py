"""The same jobs on a Dask cluster, whose scheduler and workers are processes of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from batch_cases import (
    PATIENCE,
    SAME_BYTES,
    batch,
    children,
    hanging_log,
    is_alive,
    jobs_of,
    leftovers,
    reader_below,
    results,
    small_log,
    small_logs,
    started,
    statuses,
    summary,
    until,
    write_jobs,
)

HERE = Path(__file__).resolve().parent
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": str(HERE.parent),
    "DASK_DISTRIBUTED__DASHBOARD__LINK": "",
}


@contextmanager
def running(*command, **options):
    process = subprocess.Popen(
        [sys.executable, *map(str, command)],
        env=ENVIRONMENT,
        stderr=subprocess.DEVNULL,
        text=True,
        **options,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """The address of a scheduler with two workers, as an operator would start them."""
    place = tmp_path_factory.mktemp("dask")
    about = place / "scheduler.json"
    where = ("--scheduler-file", about)
    here = ("--no-dashboard",)
    with running("-m", "distributed.cli.dask_scheduler", "--port", 0, *where, *here):
        address = until(lambda: about.exists() and about.read_text(), "the scheduler")
        worker = ("-m", "distributed.cli.dask_worker", *where, "--nthreads", 1, *here)
        options = {"cwd": place}
        with running(*worker, **options), running(*worker, **options):
            yield json.loads(address)["address"]


@contextmanager
def local_cluster():
    """Address and worker processes of a LocalCluster."""
    with running(HERE / "dask_case.py", stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        address, *pids = process.stdout.readline().split()
        yield address, [int(pid) for pid in pids]


def test_the_same_results_as_with_workers_of_our_own(scheduler, tmp_path):
    logs = small_logs(tmp_path, 5)
    logs[2].write_text("no log\n")
    jobs = jobs_of(logs, tmp_path / "jobs.yaml", limits=["areas>=1"])
    here, there = tmp_path / "here", tmp_path / "there"
    assert batch(jobs, "-o", here).returncode == 1
    done = batch(jobs, "-o", there, "--scheduler", scheduler)
    assert done.returncode == 1, done.stderr
    assert results(there) == results(here)
    assert statuses(there) == statuses(here)
    assert set(SAME_BYTES) <= set(results(there)["log0"])
    assert summary(there)["log2"]["reason"] == summary(here)["log2"]["reason"]
    assert summary(there)["log0"]["peak_memory"] > 1e7
    assert leftovers(there) == []
    again = batch(jobs, "-o", there, "--scheduler", scheduler)
    assert "log0" not in again.stderr


@pytest.mark.slow
def test_limits_hold_on_a_cluster(scheduler, tmp_path):
    small_log(tmp_path / "log0.log")
    hanging_log(tmp_path / "hangs.log")
    entries = [
        {"name": "log0", "log": "log0.log"},
        {"name": "hangs", "log": "hangs.log", "time_limit": 2},
    ]
    jobs = write_jobs(tmp_path / "jobs.yaml", entries)
    assert batch(jobs, "-o", tmp_path / "out", "--scheduler", scheduler).returncode == 1
    assert summary(tmp_path / "out")["hangs"]["reason"].startswith("took longer")
    assert statuses(tmp_path / "out")["log0"] == "done"


@pytest.mark.slow
def test_no_scheduler_answers(tmp_path):
    jobs = jobs_of(small_logs(tmp_path, 1), tmp_path / "jobs.yaml")
    done = batch(jobs, "-o", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9")
    assert done.returncode == 2
    [line] = done.stderr.splitlines()[-1:]
    assert "no Dask scheduler answers there" in line


def test_a_dask_worker_that_is_killed_costs_no_other_job(tmp_path):
    pipe = hanging_log(tmp_path / "hangs.log")
    logs = small_logs(tmp_path, 4)
    jobs = jobs_of([pipe, *logs], tmp_path / "jobs.yaml")
    out = tmp_path / "out"
    with local_cluster() as (address, workers):
        with started(jobs, "-o", out, "--scheduler", address) as process:
            reader, dask_worker = reader_below(pipe, workers)
            small = small_log(tmp_path / "good", turn=7)
            small.rename(pipe)  # what the cluster tries again is a good log
            os.kill(dask_worker, signal.SIGKILL)
            assert process.wait(PATIENCE) == 0, process.stderr.read()
        assert not is_alive(reader)
    assert set(results(out)) == {"hangs", "log0", "log1", "log2", "log3"}
    assert leftovers(out) == []


def test_the_batch_is_killed_and_its_workers_on_the_cluster_end(tmp_path):
    pipe = hanging_log(tmp_path / "hangs.log")
    jobs = jobs_of([pipe, *small_logs(tmp_path, 2)], tmp_path / "jobs.yaml")
    out = tmp_path / "out"
    with local_cluster() as (address, workers):
        with started(jobs, "-o", out, "--scheduler", address) as process:
            reader, dask_worker = reader_below(pipe, workers)
            process.kill()
            process.wait()
            until(lambda: not is_alive(reader), "the end of the worker")
        assert is_alive(dask_worker)
        assert reader not in children(dask_worker)
        pipe.unlink()
        small_log(pipe, turn=7)
        assert batch(jobs, "-o", out, "--scheduler", address).returncode == 0
    assert set(results(out)) == {"hangs", "log0", "log1"}
    assert leftovers(out) == []
