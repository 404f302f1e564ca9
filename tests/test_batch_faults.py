"""Whatever breaks costs one job, and is told: every fault made in a real process."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from batch_cases import (
    PATIENCE,
    arguments,
    batch,
    children,
    hanging_log,
    is_alive,
    jobs_of,
    leftovers,
    makings,
    reader_of,
    results,
    small_log,
    small_logs,
    started,
    statuses,
    summary,
    until,
    write_jobs,
)

LOGS = 3


def with_a_hanging_one(tmp_path, **limits):
    """Three logs, and one between them that never ends; the jobs file and the pipe."""
    first, *others = small_logs(tmp_path, LOGS)
    pipe = hanging_log(tmp_path / "hangs.log")
    entries = [{"name": log.stem, "log": log.name} for log in (first, pipe, *others)]
    entries[1] |= limits
    return write_jobs(tmp_path / "jobs.yaml", entries), pipe


def mend(pipe, turn=9):
    """What stood in the way is a good log now."""
    pipe.unlink()
    small_log(pipe, turn=turn)


def all_done(out, names=("log0", "hangs", "log1", "log2")):
    return statuses(out) == dict.fromkeys(names, "done") and set(results(out)) == set(names)


def test_a_worker_that_is_killed_costs_its_job(tmp_path):
    jobs, pipe = with_a_hanging_one(tmp_path)
    out = tmp_path / "out"
    with started(jobs, "-o", out, "--workers", 2) as process:
        os.kill(reader_of(pipe, process), signal.SIGKILL)
        assert process.wait(PATIENCE) == 1
    row = summary(out)["hangs"]
    assert (row["status"], row["metrics"]) == ("failed", {})
    assert row["reason"] == "its worker was killed by SIGKILL"
    assert set(results(out)) == {"log0", "log1", "log2"}
    assert leftovers(out) == []
    mend(pipe)
    assert batch(jobs, "-o", out).returncode == 0
    assert all_done(out)


@pytest.mark.slow
def test_a_worker_that_crashes_costs_its_job(tmp_path):
    jobs, pipe = with_a_hanging_one(tmp_path)
    with started(jobs, "-o", tmp_path / "out") as process:  # one worker, which is replaced
        os.kill(reader_of(pipe, process), signal.SIGSEGV)
        assert process.wait(PATIENCE) == 1
    assert "SIGSEGV" in summary(tmp_path / "out")["hangs"]["reason"]
    assert set(results(tmp_path / "out")) == {"log0", "log1", "log2"}


def test_a_worker_that_hangs_is_ended_at_the_time_limit(tmp_path):
    jobs, pipe = with_a_hanging_one(tmp_path, time_limit=2)
    out = tmp_path / "out"
    done = batch(jobs, "-o", out)
    assert done.returncode == 1
    row = summary(out)["hangs"]
    assert row["reason"] == "took longer than it may (limit 2 s)"
    assert row["seconds"] >= 2
    assert set(results(out)) == {"log0", "log1", "log2"}
    mend(pipe)
    assert batch(jobs, "-o", out).returncode == 0
    assert all_done(out)


@pytest.mark.slow
def test_the_time_limit_of_the_command_line_is_for_jobs_without_one(tmp_path):
    pipe = hanging_log(tmp_path / "hangs.log")
    jobs = jobs_of([pipe], tmp_path / "jobs.yaml")
    done = batch(jobs, "-o", tmp_path / "out", "--time-limit", "1.5s")
    assert done.returncode == 1
    assert "limit 1.5 s" in done.stderr


def test_a_log_that_needs_more_memory_than_its_limit(tmp_path):
    logs = small_logs(tmp_path, LOGS)
    large = tmp_path / "large.log"
    scan = small_log(large).read_text()
    # A line of three million readings, as a damaged or foreign file may have.
    large.write_text(scan + "FLASER 3000000 " + "1.25 " * 3_000_000 + "0 0 0 0 0 0 9 h 9\n")
    jobs = jobs_of([logs[0], large, *logs[1:]], tmp_path / "jobs.yaml")
    out = tmp_path / "out"
    done = batch(jobs, "-o", out, "--memory-limit", "120MB")
    assert done.returncode == 1, done.stderr
    row = summary(out)["large"]
    assert row["status"] == "failed"
    assert row["reason"] == "needs more memory than it may have (limit 120 MB)"
    assert set(results(out)) == {"log0", "log1", "log2"}
    small_log(large)
    assert batch(jobs, "-o", out, "--memory-limit", "120MB").returncode == 0
    assert all_done(out, ("log0", "large", "log1", "log2"))


def test_a_log_that_is_deleted_while_the_batch_runs(tmp_path):
    jobs, pipe = with_a_hanging_one(tmp_path)
    out = tmp_path / "out"
    with started(jobs, "-o", out) as process:
        worker = reader_of(pipe, process)
        (tmp_path / "log1.log").unlink()
        os.kill(worker, signal.SIGKILL)
        assert process.wait(PATIENCE) == 1
    assert statuses(out) == {"log0": "done", "hangs": "failed", "log1": "failed", "log2": "done"}
    assert summary(out)["log1"]["reason"].endswith("log1.log: no such file")
    small_log(tmp_path / "log1.log", turn=1)
    mend(pipe)
    assert batch(jobs, "-o", out).returncode == 0
    assert all_done(out)


@pytest.mark.slow
def test_a_log_that_changes_while_it_is_read_is_no_result(tmp_path):
    pipe = hanging_log(tmp_path / "hangs.log")
    jobs = jobs_of([pipe], tmp_path / "jobs.yaml")
    out = tmp_path / "out"
    with started(jobs, "-o", out) as process:
        reader_of(pipe, process)
        mend(pipe)  # another file of that name, while the worker has the first one open
        [worker] = children(process.pid)
        os.kill(worker, signal.SIGKILL)
        assert process.wait(PATIENCE) == 1
    assert batch(jobs, "-o", out).returncode == 0
    assert set(results(out)) == {"hangs"}


# --- the parent ---


def test_the_parent_is_killed_and_nobody_goes_on(tmp_path):
    jobs, pipe = with_a_hanging_one(tmp_path)
    out = tmp_path / "out"
    with started(jobs, "-o", out, "--workers", 2) as process:
        reader_of(pipe, process)
        workers = children(process.pid)
        assert workers
        process.kill()
        process.wait()
        until(lambda: not any(map(is_alive, workers)), "the end of the workers")
    assert not (out / "summary.json").exists()
    assert set(results(out)) <= {"log0", "log1", "log2"}
    mend(pipe)
    assert batch(jobs, "-o", out).returncode == 0
    assert all_done(out)
    assert leftovers(out) == []


@pytest.mark.parametrize("count", [5, pytest.param(40, marks=pytest.mark.slow)])
def test_killed_at_any_moment_the_end_is_the_same(tmp_path, count):
    """Each batch is killed a while after it has finished one job more; the while differs."""
    jobs = jobs_of(small_logs(tmp_path, count), tmp_path / "jobs.yaml", limits=["areas>=1"])
    assert batch(jobs, "-o", tmp_path / "undisturbed").returncode == 0
    wanted = results(tmp_path / "undisturbed")
    out = tmp_path / "out"
    made: dict[str, tuple[int, int]] = {}
    for attempt in range(count - 1):
        with started(jobs, "-o", out, "--workers", 2) as process:
            known = len(made)
            until(
                lambda known=known, process=process: (
                    len(list(out.glob("*/job.json"))) > known or process.poll() is not None
                )
            )
            time.sleep(0.013 * (attempt % 10))
            process.kill()
            process.wait()
        results(out)  # whatever is there is whole
        for name, making in makings(out).items():
            assert made.setdefault(name, making) == making, f"{name} was done twice"
        if len(made) == count:
            break
    assert batch(jobs, "-o", out).returncode == 0
    assert results(out) == wanted
    assert leftovers(out) == []
    assert made.items() <= makings(out).items()


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_batch_ends_its_workers(tmp_path, signum):
    jobs, pipe = with_a_hanging_one(tmp_path)
    with started(jobs, "-o", tmp_path / "out", "--workers", 2) as process:
        reader_of(pipe, process)
        workers = children(process.pid)
        process.send_signal(signum)
        assert process.wait(PATIENCE) == 130
        assert process.stderr.read().splitlines()[-1] == "hiermap: interrupted"
        assert not any(map(is_alive, workers))
    assert leftovers(tmp_path / "out") == []


def test_a_second_batch_into_the_same_folder_is_refused(tmp_path):
    jobs, pipe = with_a_hanging_one(tmp_path)
    out = tmp_path / "out"
    with started(jobs, "-o", out) as process:
        worker = reader_of(pipe, process)
        second = batch(jobs, "-o", out)
        assert second.returncode == 2
        assert second.stderr.splitlines() == [
            f"hiermap: {out}: another batch is at work there; wait for it, or choose another -o"
        ]
        os.kill(worker, signal.SIGKILL)
        assert process.wait(PATIENCE) == 1
    mend(pipe)
    assert batch(jobs, "-o", out).returncode == 0
    assert all_done(out)


# --- the disk ---


@contextmanager
def mounted(place, *options):
    """A small file system in memory; skips where it may not be mounted."""
    place.mkdir(exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", ",".join(options), "tmpfs", str(place)]
    if shutil.which("mount") is None:
        pytest.skip("no mount here")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no small disk may be mounted: {done.stderr.strip()}")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_full_disk(tmp_path):
    logs = small_logs(tmp_path, 12)
    jobs = jobs_of(logs, tmp_path / "jobs.yaml")
    with mounted(tmp_path / "disk", "size=300k") as disk:
        out = disk / "out"
        done = batch(jobs, "-o", out)
        assert done.returncode == 1
        assert "No space left on device" in done.stderr
        assert "fault of the program" not in done.stderr
        kept = results(out)
        assert 0 < len(kept) < 12
        assert leftovers(out) == []
        if (out / "summary.json").exists():  # there may have been room for it
            rows = summary(out)
            assert {name for name, row in rows.items() if row["status"] == "done"} == set(kept)
        subprocess.run(["mount", "-o", "remount,size=10m", str(disk)], check=True)
        assert batch(jobs, "-o", out).returncode == 0
        assert len(results(out)) == 12
        assert kept.items() <= results(out).items()


def test_a_disk_that_takes_no_large_files(tmp_path):
    """The same without a right to mount: files end at some size, as by a quota."""
    jobs = jobs_of(small_logs(tmp_path, 2), tmp_path / "jobs.yaml")
    out = tmp_path / "out"
    limited = ["bash", "-c", 'ulimit -f 8; exec "$@"', "bash"]
    done = subprocess.run(
        [*limited, *arguments(jobs, "-o", out)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stderr
    rows = summary(out)
    assert {row["status"] for row in rows.values()} == {"failed"}
    assert all("File too large" in row["reason"] for row in rows.values())
    assert results(out) == {}
    assert leftovers(out) == []
    assert batch(jobs, "-o", out).returncode == 0
    assert len(results(out)) == 2


def test_a_folder_that_cannot_be_written(tmp_path):
    jobs = jobs_of(small_logs(tmp_path, 1), tmp_path / "jobs.yaml")
    if os.geteuid() == 0:
        with mounted(tmp_path / "disk", "ro") as disk:
            refused(batch(jobs, "-o", disk / "out"))
    else:
        closed = tmp_path / "closed"
        closed.mkdir(mode=0o555)
        refused(batch(jobs, "-o", closed / "out"))


def refused(done):
    assert done.returncode == 2
    [line] = done.stderr.splitlines()
    assert "cannot be written" in line
    assert "choose another" in line


@pytest.mark.slow
def test_a_folder_that_is_closed_while_the_batch_runs(tmp_path):
    jobs, pipe = with_a_hanging_one(tmp_path)
    with mounted(tmp_path / "disk", "size=10m") as disk:
        out = disk / "out"
        with started(jobs, "-o", out) as process:
            worker = reader_of(pipe, process)
            until(lambda: "log0" in results(out))
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=False)
            os.kill(worker, signal.SIGKILL)
            status = process.wait(PATIENCE)
            said = process.stderr.read()
        subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)
        assert status in (1, 2)
        assert "fault of the program" not in said
        mend(pipe)
        assert batch(jobs, "-o", out).returncode == 0
        assert all_done(out)


def test_a_jobs_fault_of_the_program_keeps_its_traceback(tmp_path):
    log = small_log(tmp_path / "a.log")
    other = small_log(tmp_path / "b.log", turn=1)
    jobs = write_jobs(
        tmp_path / "jobs.yaml",
        [{"name": "n/a", "log": str(log)}, {"name": "b", "log": str(other)}],
    )
    broken = tmp_path / "site"
    broken.mkdir()
    # A fault in a package that only the run of one log meets.
    (broken / "sitecustomize.py").write_text(
        "import hiermap_cli.batch.run_log as m\n"
        "old = m.MappedLog.write\n"
        "def write(self, folder):\n"
        "    if self.source.log == 'a.log':\n"
        "        raise ZeroDivisionError('a fault')\n"
        "    return old(self, folder)\n"
        "m.MappedLog.write = write\n"
    )
    here = os.pathsep.join([str(broken), str(Path.cwd())])
    out = tmp_path / "out"
    done = batch(jobs, "-o", out, env={**os.environ, "PYTHONPATH": here})
    assert done.returncode == 1
    assert statuses(out) == {"n/a": "failed", "b": "done"}
    assert "a fault of the program (ZeroDivisionError: a fault)" in done.stderr
    assert "sitecustomize.py" in (out / "n" / "a.traceback.txt").read_text()
    assert batch(jobs, "-o", out).returncode == 0
    assert leftovers(out) == []
