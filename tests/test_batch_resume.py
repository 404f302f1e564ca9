"""What is done is done: a batch said again does the rest, and nothing twice."""

from __future__ import annotations

import json
import os
import shutil
import time

import pytest
from batch_cases import (
    batch,
    jobs_of,
    leftovers,
    makings,
    results,
    small_log,
    small_logs,
    statuses,
    summary,
    write_jobs,
)

from hiermap_cli.batch import content
from hiermap_cli.batch.batch import _sorted_out
from hiermap_cli.batch.content import Known, look, read_record
from hiermap_cli.batch.jobs_file import read_jobs
from hiermap_cli.errors import InputError


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three logs and the folder of their batch."""
    folder = tmp_path_factory.mktemp("made")
    jobs = jobs_of(small_logs(folder, 3), folder / "jobs.yaml")
    done = batch(jobs, "-o", folder / "out")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def finished(made, tmp_path):
    """A copy of them: folder, jobs file, and the batch's folder."""
    shutil.copytree(made, tmp_path / "copy")
    folder = tmp_path / "copy"
    return folder, folder / "jobs.yaml", folder / "out"


def test_every_result_is_whole_and_nothing_else_is_left(finished):
    _, _, out = finished
    assert set(results(out)) == {"log0", "log1", "log2"}
    assert leftovers(out) == []


def test_a_finished_batch_does_nothing_again(finished):
    _, jobs, out = finished
    before, first = makings(out), (out / "summary.json").read_bytes()
    done = batch(jobs, "-o", out)
    assert done.returncode == 0
    assert "[1/" not in done.stderr
    assert makings(out) == before
    assert (out / "summary.json").read_bytes() == first


def test_a_log_of_another_content_is_done_again_and_no_other(finished):
    folder, jobs, out = finished
    before = makings(out)
    small_log(folder / "log1.log", turn=99)
    assert batch(jobs, "-o", out).returncode == 0
    after = makings(out)
    assert {name for name in after if after[name] != before[name]} == {"log1"}
    assert leftovers(out) == []


def test_a_log_that_was_only_touched_is_not_done_again(finished):
    folder, jobs, out = finished
    before = makings(out)
    os.utime(folder / "log1.log")
    done = batch(jobs, "-o", out, "-v")
    assert done.returncode == 0
    assert "log1: done, kept" in done.stderr
    assert makings(out) == before


@pytest.mark.slow
def test_a_log_that_moved_with_its_jobs_file_is_not_done_again(finished):
    folder, _, out = finished
    before = makings(out)
    for index in range(3):
        shutil.copy(folder / f"log{index}.log", folder / f"moved{index}.log")
    entries = [{"name": f"log{i}", "log": f"moved{i}.log"} for i in range(3)]
    write_jobs(folder / "moved.yaml", entries)
    assert batch(folder / "moved.yaml", "-o", out).returncode == 0
    assert makings(out) == before


@pytest.fixture(scope="module")
def judged(made, tmp_path_factory):
    """A job with a truth and a limit, finished: folder and entry of its jobs file."""
    folder = tmp_path_factory.mktemp("judged")
    shutil.copy(made / "log0.log", folder / "a.log")
    shutil.copy(made / "out" / "log0" / "trajectory.tum", folder / "truth.tum")
    entry = {"name": "a", "log": "a.log", "trajectory": "truth.tum", "limits": ["ate_rmse<=9"]}
    done = batch(write_jobs(folder / "jobs.yaml", [entry]), "-o", folder / "out")
    assert done.returncode == 0, done.stderr
    return folder, entry


@pytest.fixture
def again(judged, tmp_path):
    """A copy of it, and what runs it again with changes: the exit status and its row."""
    shutil.copytree(judged[0], tmp_path / "copy")
    folder, entry = tmp_path / "copy", judged[1]

    def run(**changes):
        write_jobs(folder / "jobs.yaml", [{**entry, **changes}])
        done = batch(folder / "jobs.yaml", "-o", folder / "out")
        return done.returncode, summary(folder / "out")["a"]

    return folder, run


def test_another_configuration_is_another_run(again):
    folder, run = again
    before = makings(folder / "out")
    (folder / "c.yaml").write_text("segmentation: {min_points: 9}\n")
    assert run(config="c.yaml")[0] == 0
    assert makings(folder / "out") != before


def test_other_limits_are_held_by_the_same_run(again):
    folder, run = again
    before = makings(folder / "out")
    status, row = run(limits=["ate_rmse<=9", "areas>=99"])
    assert (status, row["status"]) == (3, "limit_missed")
    assert [one["passed"] for one in row["limits"]] == [True, False]
    assert set(row["metrics"]) >= {"ate_rmse", "areas"}
    status, row = run(limits=[], trajectory=None)
    assert (status, row["status"], row["limits"]) == (0, "done", [])
    assert "ate_rmse" not in row["metrics"]
    assert not (folder / "out" / "a" / "eval.json").exists()
    assert makings(folder / "out") == before
    assert leftovers(folder / "out") == []


def test_another_truth_judges_the_same_run(again):
    folder, run = again
    before = makings(folder / "out")
    lines = (folder / "truth.tum").read_text().splitlines()
    t, x, *rest = lines[-1].split()
    lines[-1] = " ".join([t, str(float(x) + 1.0), *rest])
    (folder / "truth.tum").write_text("\n".join(lines) + "\n")
    _, row = run()
    assert row["metrics"]["ate_rmse"] > 0.01
    assert makings(folder / "out") == before


def test_a_truth_that_cannot_be_read_costs_no_run(again):
    folder, run = again
    before = makings(folder / "out")
    truth = (folder / "truth.tum").read_text()
    (folder / "truth.tum").write_text("no trajectory\n")
    status, row = run()
    assert (status, row["status"]) == (1, "failed")
    (folder / "truth.tum").write_text(truth)
    assert run()[0] == 0
    assert makings(folder / "out") == before


@pytest.mark.slow
def test_a_comment_in_the_configuration_is_not(tmp_path):
    log = small_log(tmp_path / "a.log")
    (tmp_path / "c.yaml").write_text("segmentation: {min_points: 6}\n")
    jobs = jobs_of([log], tmp_path / "jobs.yaml", config="c.yaml")
    assert batch(jobs, "-o", tmp_path / "out").returncode == 0
    before = makings(tmp_path / "out")
    (tmp_path / "c.yaml").write_text("# why\nsegmentation:\n  min_points: 6\n")
    assert batch(jobs, "-o", tmp_path / "out").returncode == 0
    assert makings(tmp_path / "out") == before


def test_a_missed_limit_is_done_and_a_failed_job_is_tried_again(tmp_path):
    logs = small_logs(tmp_path, 2)
    logs[1].write_text("no log\n")
    jobs = jobs_of(logs, tmp_path / "jobs.yaml", limits=["landmarks>=1000"])
    out = tmp_path / "out"
    assert batch(jobs, "-o", out).returncode == 1
    assert statuses(out) == {"log0": "limit_missed", "log1": "failed"}
    before = makings(out)
    small_log(logs[1], turn=1)
    again = batch(jobs, "-o", out)
    assert again.returncode == 3
    assert "log0: limit missed, kept: landmarks>=1000: " in again.stderr
    assert statuses(out) == {"log0": "limit_missed", "log1": "limit_missed"}
    assert makings(out)["log0"] == before["log0"]


def test_a_result_of_other_contents_is_gone_when_the_job_fails(finished):
    folder, jobs, out = finished
    (folder / "log1.log").write_text("no log\n")
    assert batch(jobs, "-o", out).returncode == 1
    assert statuses(out)["log1"] == "failed"
    assert set(results(out)) == {"log0", "log2"}
    assert leftovers(out) == []


def test_a_result_stays_when_its_log_is_gone(finished):
    folder, jobs, out = finished
    (folder / "log1.log").unlink()
    assert batch(jobs, "-o", out).returncode == 1
    row = summary(out)["log1"]
    assert row["status"] == "failed"
    assert row["reason"].endswith("log1.log: no such file")
    assert set(results(out)) == {"log0", "log1", "log2"}


def test_a_damaged_result_is_made_again(finished):
    _, jobs, out = finished
    (out / "log0" / "trajectory.tum").unlink()
    (out / "log1" / "job.json").write_text("{")
    record = json.loads((out / "log2" / "job.json").read_text())
    record["inputs"]["log"]["sha256"] = "0" * 64
    (out / "log2" / "job.json").write_text(json.dumps(record))
    assert batch(jobs, "-o", out).returncode == 0
    assert set(results(out)) == {"log0", "log1", "log2"}


@pytest.mark.slow
def test_what_no_batch_has_made_is_never_replaced(tmp_path):
    log = small_log(tmp_path / "a.log")
    jobs = jobs_of([log], tmp_path / "jobs.yaml")
    mine = tmp_path / "out" / "a" / "model.json"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    assert batch(jobs, "-o", tmp_path / "out").returncode == 1
    assert (
        "holds a model.json that hiermap did not write" in summary(tmp_path / "out")["a"]["reason"]
    )
    assert mine.read_text() == "mine"


def test_a_file_of_somebody_elses_beside_a_result_stays(finished):
    folder, jobs, out = finished
    (out / "log1" / "notes.txt").write_text("mine")
    small_log(folder / "log1.log", turn=99)
    assert batch(jobs, "-o", out).returncode == 1
    reason = summary(out)["log1"]["reason"]
    assert "holds notes.txt, which is no part of an earlier result of a batch" in reason
    assert (out / "log1" / "notes.txt").read_text() == "mine"
    assert leftovers(out) == []


@pytest.mark.parametrize("name", ["summary.json", "junit.xml", "summary.md"])
def test_a_report_that_no_batch_wrote_is_never_replaced(tmp_path, name):
    jobs = jobs_of([small_log(tmp_path / "a.log")], tmp_path / "jobs.yaml")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("mine")
    done = batch(jobs, "-o", tmp_path / "out")
    assert done.returncode == 2
    assert f"{name}: exists and is none that a batch wrote" in done.stderr
    assert [path.name for path in (tmp_path / "out").iterdir()] == [name]


def test_a_folder_of_a_bag_is_known_by_all_of_its_files(tmp_path):
    (tmp_path / "bag" / "sub").mkdir(parents=True)
    (tmp_path / "bag" / "metadata.yaml").write_text("x")
    (tmp_path / "bag" / "sub" / "a.db3").write_text("y")
    first = look(tmp_path / "bag")
    (tmp_path / "bag" / "sub" / "a.db3").write_text("z")
    second = look(tmp_path / "bag")
    assert first.sha256 != second.sha256
    assert first.state != second.state


# --- states ---


def test_a_state_is_trusted_only_when_it_has_settled(tmp_path):
    path = tmp_path / "a"
    path.write_text("x")
    known = look(path)
    assert not known.is_unchanged(path)  # it may change again within one tick of the clock
    later = Known(known.sha256, known.state, time.time_ns() + 2 * content.SETTLED_NS)
    assert later.is_unchanged(path)
    path.write_text("y")
    assert not later.is_unchanged(path)


def test_a_file_put_back_with_its_times_is_seen(tmp_path):
    path = tmp_path / "a"
    path.write_text("x")
    about = path.stat()
    known = look(path)
    later = Known(known.sha256, known.state, time.time_ns() + 2 * content.SETTLED_NS)
    path.write_text("y")
    os.utime(path, ns=(about.st_atime_ns, about.st_mtime_ns))
    assert path.stat().st_mtime_ns == about.st_mtime_ns
    assert not later.is_unchanged(path)


def test_a_batch_looks_at_no_content_where_states_have_settled(finished, monkeypatch):
    folder, jobs, out = finished
    assert batch(jobs, "-o", out).returncode == 0  # it notes the states of the copies
    monkeypatch.setattr(content, "SETTLED_NS", -(10**12))
    opened = []
    monkeypatch.setattr(content, "content_digest", opened.append)
    to_do, kept = _sorted_out(read_jobs(jobs), out)
    assert [job.name for job in to_do] == []
    assert [outcome.name for outcome in kept] == ["log0", "log1", "log2"]
    assert opened == []
    small_log(folder / "log2.log", turn=5)
    to_do, _ = _sorted_out(read_jobs(jobs), out)
    assert [job.name for job in to_do] == ["log2"]


def test_what_is_not_there_has_no_state(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        look(tmp_path / "gone")
    assert read_record(tmp_path / "gone") is None
