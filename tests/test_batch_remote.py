"""Logs at addresses: fetched, kept no longer than their job, known again by what servers say."""

from __future__ import annotations

import functools
import http.server
import threading

import fsspec
import pytest
from batch_cases import batch, leftovers, results, small_log, small_logs, summary, write_jobs

from hiermap_cli.batch.jobs_file import read_jobs
from hiermap_cli.batch.remote import check_url, expand_url, fetch, remote_state, shown
from hiermap_cli.batch.run_job import run_job
from hiermap_cli.errors import ConfigurationError, InputError


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass

    def do_GET(self):
        self.server.asked.append(self.path)
        super().do_GET()


@pytest.fixture
def served(tmp_path):
    """A folder, the address under which it is served, and the paths that were fetched."""
    folder = tmp_path / "served"
    folder.mkdir()
    handler = functools.partial(Quiet, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.asked = []
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield folder, f"http://127.0.0.1:{server.server_port}", server.asked
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def memory():
    """A store in memory, empty."""
    files = fsspec.filesystem("memory")
    files.store.clear()
    yield files
    files.store.clear()


def test_logs_over_http(served, tmp_path):
    folder, address, asked = served
    small_log(folder / "a b.log")
    small_log(folder / "c.log", turn=1)
    jobs = write_jobs(
        tmp_path / "jobs.yaml",
        [
            {"name": "n", "log": [f"{address}/a%20b.log", f"{address}/c.log?token=secret"]},
            {"name": "gone", "log": f"{address}/gone.log?token=secret"},
        ],
    )
    out = tmp_path / "out"
    done = batch(jobs, "-o", out)
    assert done.returncode == 1, done.stderr
    assert set(results(out)) == {"n/a b", "n/c"}
    assert summary(out)["gone"]["reason"] == f"{address}/gone.log: no such file"
    assert leftovers(out) == []
    assert "secret" not in done.stderr
    for path in out.rglob("*"):
        assert not path.is_file() or b"secret" not in path.read_bytes(), path
    asked.clear()
    assert batch(jobs, "-o", out).returncode == 1
    assert [path for path in asked if "gone" not in path] == []  # only their heads were asked for


def test_a_log_that_changed_on_its_server_is_done_again(served, tmp_path):
    folder, address, _ = served
    small_log(folder / "a.log")
    jobs = write_jobs(tmp_path / "jobs.yaml", [{"name": "a", "log": f"{address}/a.log"}])
    assert batch(jobs, "-o", tmp_path / "out").returncode == 0
    before = results(tmp_path / "out")
    small_log(folder / "a.log", turn=1, scans=6)
    assert batch(jobs, "-o", tmp_path / "out").returncode == 0
    assert results(tmp_path / "out") != before


@pytest.mark.slow
def test_a_damaged_log_is_called_by_its_address(served, tmp_path):
    folder, address, _ = served
    (folder / "a.log").write_text("no log\n")
    jobs = write_jobs(tmp_path / "jobs.yaml", [{"name": "a", "log": f"{address}/a.log?key=x"}])
    assert batch(jobs, "-o", tmp_path / "out").returncode == 1
    reason = summary(tmp_path / "out")["a"]["reason"]
    assert reason.startswith(f"{address}/a.log")
    assert ".partial" not in reason


def test_a_store_is_searched_by_a_pattern(memory, tmp_path):
    for name in ("2026-01/a.mcap", "2026-02/b.mcap", "2026-02/c.txt"):
        memory.pipe(f"/store/{name}", b"x")
    assert expand_url("memory://store/2026-*/*.mcap") == [
        "memory:///store/2026-01/a.mcap",
        "memory:///store/2026-02/b.mcap",
    ]
    path = tmp_path / "jobs.yaml"
    write_jobs(path, [{"name": "n", "log": "memory:///store/2026-*/*.mcap"}])
    assert [job.name for job in read_jobs(path)] == ["n/2026-01/a", "n/2026-02/b"]


def test_a_log_in_a_store_gives_what_it_gives_here(memory, tmp_path):
    log = small_log(tmp_path / "a.log")
    memory.pipe("/store/a.log", log.read_bytes())
    write_jobs(tmp_path / "here.yaml", [{"name": "a", "log": "a.log"}])
    write_jobs(tmp_path / "there.yaml", [{"name": "a", "log": "memory://store/a.log"}])
    for place in ("here", "there"):
        [job] = read_jobs(tmp_path / f"{place}.yaml")
        outcome = run_job(job, tmp_path / place, tmp_path / place / ".partial")
        assert outcome.status == "done", outcome.reason
    assert results(tmp_path / "here") == results(tmp_path / "there")
    [job] = read_jobs(tmp_path / "there.yaml")
    assert run_job(job, tmp_path / "there", tmp_path / "there" / ".partial").kept


def test_a_folder_in_a_store_is_fetched_whole(memory, tmp_path):
    memory.pipe("/store/bag/metadata.yaml", b"x")
    memory.pipe("/store/bag/bag_0.db3", b"y")
    folder = fetch("memory://store/bag", tmp_path)
    assert sorted(path.name for path in folder.iterdir()) == ["bag_0.db3", "metadata.yaml"]


@pytest.mark.usefixtures("memory")
def test_what_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"memory://store/gone\.mcap: no such file"):
        remote_state("memory://store/gone.mcap")
    with pytest.raises(InputError, match="no such file"):
        fetch("memory://store/gone.mcap", tmp_path)


def test_a_server_that_cannot_be_reached():
    with pytest.raises(InputError, match=r"cannot be fetched \(Client"):
        remote_state("http://127.0.0.1:9/a.mcap?token=secret")


def test_secrets_are_not_shown():
    assert shown("https://user:word@host:8/a/b.mcap?sig=1") == "https://host:8/a/b.mcap"


def test_kinds_of_addresses_that_are_not_known():
    with pytest.raises(ValueError, match="gopher:// is not known"):
        check_url("gopher://host/a")


def test_an_address_of_no_known_kind_is_a_fault_of_the_file(tmp_path):
    path = write_jobs(tmp_path / "jobs.yaml", [{"name": "n", "log": "gopher://host/a.mcap"}])
    with pytest.raises(ConfigurationError, match="gopher"):
        read_jobs(path)


def test_a_fault_of_the_disk_is_no_fault_of_the_server(memory, tmp_path):
    memory.pipe("/store/a.log", b"x")
    with pytest.raises(OSError, match="No such file or directory"):
        fetch("memory://store/a.log", tmp_path / "no folder")


def test_logs_of_one_name_in_two_places_have_two_names(memory, tmp_path):
    for log in small_logs(tmp_path, 2):
        memory.pipe(f"/store/{log.stem}/run.log", log.read_bytes())
    path = write_jobs(
        tmp_path / "jobs.yaml",
        [{"name": "n", "log": ["memory://store/log0/run.log", "memory://store/log1/run.log"]}],
    )
    assert [job.name for job in read_jobs(path)] == ["n/log0/run", "n/log1/run"]
