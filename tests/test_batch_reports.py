"""What a batch says in the end: summary.json, JUnit, Markdown, exit status; and shards of it."""

from __future__ import annotations

import json
import shutil
import threading
import xml.etree.ElementTree as ET
from functools import partial

import pytest
from batch_cases import (
    SAME_BYTES,
    batch,
    hanging_log,
    jobs_of,
    leftovers,
    open_files,
    reader_of,
    results,
    small_log,
    small_logs,
    started,
    statuses,
    summary,
    write_jobs,
)
from jsonschema import Draft202012Validator
from world_cases import DATASETS

from hiermap_cli.batch.batch import Options, run_batch
from hiermap_cli.batch.folder_lock import Shard, is_free, lock_folder, lock_path, parse_shard
from hiermap_cli.batch.jobs_file import read_jobs
from hiermap_cli.batch.summary import Tally, write_reports
from hiermap_cli.documents.schema import shipped_schema
from hiermap_cli.errors import EXIT_INPUT, EXIT_LIMIT, EXIT_OK, UsageError


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """A batch with one job of each end, and its process."""
    folder = tmp_path_factory.mktemp("mixed")
    small_log(folder / "good.log")
    (folder / "bad.log").write_text("no log\n")
    data = DATASETS / "room_corridor"
    entries = [
        {"name": "good", "log": "good.log", "limits": ["areas>=1"]},
        {"name": "bad|log", "log": "bad.log"},
        {
            "name": "sim/room",
            "log": str(data / "log.mcap"),
            "trajectory": "{folder}/truth.tum",
            "reference": "{folder}/reference.json",
            "limits": ["ate_rmse<=0.5", "ate_rmse<=0.0001", "relations_rot_mean<1"],
        },
    ]
    jobs = write_jobs(folder / "jobs.yaml", entries)
    return folder / "out", batch(jobs, "-o", folder / "out", "--workers", 2, "--json")


def test_one_goes_before_three(mixed):
    _, done = mixed
    assert done.returncode == 1
    assert "3 jobs: 1 done, 1 missed a limit, 1 failed" in done.stderr


def test_the_summary_has_a_row_for_every_job_in_their_order(mixed):
    out, done = mixed
    text = (out / "summary.json").read_text()
    document = json.loads(text)
    schema = json.loads(shipped_schema("summary"))
    assert list(Draft202012Validator(schema).iter_errors(document)) == []
    good, bad, room = document["jobs"]
    assert [row["name"] for row in document["jobs"]] == ["good", "bad|log", "sim/room"]
    assert (good["status"], good["reason"]) == ("done", None)
    assert good["metrics"]["areas"] == 1
    assert good["seconds"] > 0
    assert good["peak_memory"] > 10_000_000
    assert (bad["status"], bad["metrics"]) == ("failed", {})
    assert "bad.log" in bad["reason"]
    assert room["status"] == "limit_missed"
    assert room["reason"].startswith("ate_rmse<=0.0001: it is 0.0")
    assert "relations_rot_mean<1: could not be measured: " in room["reason"]
    assert room["metrics"]["ate_rmse"] < 0.5
    assert room["metrics"]["areas"] >= 1
    assert done.stdout == text


def test_a_missed_limit_has_an_evaluation(mixed):
    out, _ = mixed
    document = json.loads((out / "sim" / "room" / "eval.json").read_text())
    assert document["passed"] is False
    assert [one["passed"] for one in document["limits"]] == [True, False, False]


def test_junit_tells_failures_from_errors(mixed):
    out, _ = mixed
    suite = ET.parse(out / "junit.xml").getroot().find("testsuite")
    assert {key: suite.get(key) for key in ("tests", "failures", "errors")} == {
        "tests": "3",
        "failures": "1",
        "errors": "1",
    }
    good, bad, room = suite.findall("testcase")
    assert {said.tag for said in good} <= {"system-out"}  # a warning, if anything
    assert bad.find("error") is not None
    assert "ate_rmse<=0.0001" in room.find("failure").get("message")
    assert float(room.get("time")) > 0


def test_markdown_tells_what_went_wrong_first(mixed):
    out, _ = mixed
    text = (out / "summary.md").read_text()
    heads = [line for line in text.splitlines() if line.startswith("| job ")]
    assert [head.split("|")[-2].strip() for head in heads] == ["reason", "limits"]
    assert text.startswith("## hiermap batch: 3 jobs: 1 done, 1 missed a limit, 1 failed\n")
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    names = [row.split(" | ")[0] for row in rows]
    assert names == ["| job", "| ---", "| bad\\|log", "| sim/room", "| job", "| ---", "| good"]
    assert "relations\\_rot" in text or "not measured" in text


def test_exit_statuses():
    assert Tally(3).exit_status == EXIT_OK
    assert Tally(3, limit_missed=1).exit_status == EXIT_LIMIT
    assert Tally(3, limit_missed=1, failed=1).exit_status == EXIT_INPUT


def test_many_rows_stay_within_what_ci_shows(tmp_path):
    row = {"name": "n", "status": "done", "reason": None, "metrics": {}, "seconds": 1.0}
    tally = write_reports(tmp_path, lambda: ({**row, "peak_memory": 1} for _ in range(2000)))
    assert tally == Tally(2000)
    text = (tmp_path / "summary.md").read_text()
    assert text.count("\n| n ") == 500
    assert "and 1500 more jobs done" in text
    assert len(json.loads((tmp_path / "summary.json").read_text())["jobs"]) == 2000


def test_any_number_of_workers_gives_the_same_bytes(tmp_path):
    logs = small_logs(tmp_path, 6)
    entries = [{"name": log.stem, "log": log.name, "limits": ["areas>=1"]} for log in logs]
    jobs = write_jobs(tmp_path / "jobs.yaml", entries)
    found = []
    for workers in (1, 3):
        out = tmp_path / str(workers)
        assert batch(jobs, "-o", out, "--workers", workers).returncode == 0
        found.append(results(out))
    assert found[0] == found[1]
    assert set(found[0]["log0"]) == set(SAME_BYTES)


@pytest.mark.slow
def test_the_results_of_a_batch_are_those_of_a_run(tmp_path):
    from click.testing import CliRunner

    from hiermap_cli.commands.main import cli

    log = small_log(tmp_path / "a.log")
    jobs = jobs_of([log], tmp_path / "jobs.yaml")
    assert batch(jobs, "-o", tmp_path / "out").returncode == 0
    done = CliRunner().invoke(cli, ["run", str(log), "-o", str(tmp_path / "run"), "-q"])
    assert done.exit_code == 0
    for name in ("model.json", "trajectory.tum", "map.svg"):
        assert (tmp_path / "run" / name).read_bytes() == (
            tmp_path / "out" / "a" / name
        ).read_bytes()


# --- shards ---


def test_shards_share_the_jobs_and_put_one_summary_together(tmp_path):
    logs = small_logs(tmp_path, 5)
    logs[3].write_text("no log\n")
    jobs = jobs_of(logs, tmp_path / "jobs.yaml")
    out = tmp_path / "out"
    first = batch(jobs, "-o", out, "--shard", "1/2")
    assert first.returncode == 0
    assert list(statuses(out)) == ["log0", "log2", "log4"]
    second = batch(jobs, "-o", out, "--shard", "2/2")
    assert second.returncode == 1
    assert list(statuses(out)) == [f"log{i}" for i in range(5)]
    assert statuses(out)["log3"] == "failed"
    assert {row["name"] for row in read_shard(out, "2-of-2")} == {"log1", "log3"}
    whole = batch(jobs, "-o", out)
    assert whole.returncode == 1
    assert "log0" not in whole.stderr  # it is done
    assert set(statuses(out).values()) == {"done", "failed"}


def read_shard(out, label):
    return json.loads((out / f"summary-{label}.json").read_text())["jobs"]


@pytest.mark.slow
def test_shards_at_work_together(tmp_path):
    jobs = jobs_of(small_logs(tmp_path, 6), tmp_path / "jobs.yaml")
    out = tmp_path / "out"
    shard = partial(started, jobs, "-o", out, "--shard")
    with shard("1/3") as one, shard("2/3") as two:
        assert batch(jobs, "-o", out, "--shard", "3/3").returncode == 0
        assert one.wait(60) == 0
        assert two.wait(60) == 0
    assert list(statuses(out)) == [f"log{i}" for i in range(6)]
    assert [path for path in leftovers(out) if "-of-3" not in path] == []


@pytest.mark.slow
def test_more_shards_than_jobs(tmp_path):
    jobs = jobs_of(small_logs(tmp_path, 1), tmp_path / "jobs.yaml")
    assert batch(jobs, "-o", tmp_path / "out", "--shard", "4/4").returncode == 0
    assert summary(tmp_path / "out") == {}


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "1/0", "-1/2", ""])
def test_what_is_no_shard(text):
    with pytest.raises(ValueError, match="no i/n"):
        parse_shard(text)


# --- the lock ---


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr("hiermap_cli.batch.folder_lock.PATIENCE", 0.1)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("first", "second", "both"),
    [
        (Shard(), Shard(), False),
        (Shard(1, 2), Shard(2, 2), True),
        (Shard(1, 2), Shard(1, 2), False),
        (Shard(1, 2), Shard(), False),
        (Shard(), Shard(1, 2), False),
        (Shard(1, 2), Shard(1, 3), False),
    ],
)
def test_who_may_work_in_a_folder_together(tmp_path, first, second, both):
    with lock_folder(tmp_path, first):
        if both:
            with lock_folder(tmp_path, second):
                pass
        else:
            with pytest.raises(UsageError, match="is at work there"), lock_folder(tmp_path, second):
                pass
    with lock_folder(tmp_path, second):  # the first has gone
        assert not is_free(lock_path(tmp_path, second))
    assert is_free(lock_path(tmp_path, second))


def test_who_waits_a_little_gets_a_lock_whose_owner_dies(tmp_path):
    held = lock_folder(tmp_path, Shard())
    held.__enter__()
    timer = threading.Timer(0.2, lambda: held.__exit__(None, None, None))
    timer.start()
    with lock_folder(tmp_path, Shard()):
        timer.join()


def test_the_lock_is_held_as_long_as_a_worker_lives(tmp_path):
    """Workers inherit it: a batch that begins after a killed one meets none of its workers."""
    pipe = hanging_log(tmp_path / "hangs.log")
    jobs = jobs_of([pipe], tmp_path / "jobs.yaml")
    with started(jobs, "-o", tmp_path / "out") as process:
        worker = reader_of(pipe, process)
        lock = str(tmp_path / "out" / ".lock")
        assert lock in open_files(worker)


# --- as a library ---


def test_a_batch_is_a_function(tmp_path):
    jobs = read_jobs(jobs_of(small_logs(tmp_path, 2), tmp_path / "jobs.yaml"))
    tally = run_batch(jobs, tmp_path / "out", Options(workers=1))
    assert tally == Tally(done=2)
    assert set(results(tmp_path / "out")) == {"log0", "log1"}
    shutil.rmtree(tmp_path / "out")
    assert run_batch([], tmp_path / "out") == Tally()
