"""JOBS.yaml: read whole, unfolded into jobs of their own names, every fault said at once."""

from __future__ import annotations

from pathlib import Path

import pytest
from batch_cases import batch, write_jobs

from hiermap_cli.batch.jobs_file import read_jobs
from hiermap_cli.batch.patterns import without_ending
from hiermap_cli.batch.quantities import bytes_text, parse_bytes, parse_seconds, seconds_text
from hiermap_cli.errors import ConfigurationError


def touch(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def read(folder: Path, text: str):
    path = folder / "jobs.yaml"
    path.write_text(text)
    return read_jobs(path)


def names(folder: Path, text: str) -> list[str]:
    return [job.name for job in read(folder, text)]


def faults(folder: Path, text: str) -> list[str]:
    with pytest.raises(ConfigurationError) as caught:
        read(folder, text)
    return caught.value.faults


# --- names ---


def test_a_path_is_one_job_of_that_name(tmp_path):
    [job] = read(tmp_path, "jobs:\n  - {name: w1, log: logs/a.mcap}\n")
    assert job.name == "w1"
    assert job.log == str(tmp_path / "logs" / "a.mcap")
    assert job.config.values["segmentation"]


def test_a_glob_is_a_job_for_each_log_named_after_its_open_part(tmp_path):
    touch(tmp_path, "logs/2026-01/a.mcap", "logs/2026-01/b.log.gz", "logs/2026-02/a.mcap")
    assert names(tmp_path, "jobs: [{name: night, log: 'logs/2026-*/*'}]") == [
        "night/2026-01/a",
        "night/2026-01/b",
        "night/2026-02/a",
    ]


def test_two_stars_go_down_any_number_of_folders(tmp_path):
    touch(tmp_path, "a/log.mcap", "b/c/log.mcap")
    assert names(tmp_path, "jobs: [{name: n, log: '**/log.mcap'}]") == ["n/a/log", "n/b/c/log"]


def test_a_list_is_named_after_what_its_items_do_not_share(tmp_path):
    text = "jobs: [{name: n, log: [logs/a/log.mcap, logs/b/log.mcap]}]"
    assert names(tmp_path, text) == ["n/a/log", "n/b/log"]
    assert names(tmp_path, "jobs: [{name: n, log: [logs/x.mcap]}]") == ["n/x"]


def test_a_log_that_two_patterns_find_is_one_job(tmp_path):
    touch(tmp_path, "logs/a.mcap", "logs/b.mcap")
    text = "jobs: [{name: n, log: ['logs/*.mcap', logs/a.mcap]}]"
    assert names(tmp_path, text) == ["n/a", "n/b"]


def test_every_log_with_every_configuration(tmp_path):
    touch(tmp_path, "logs/a.mcap", "logs/b.mcap", "one.yaml", "two.yaml")
    text = "jobs: [{name: n, log: 'logs/*', config: [one.yaml, two.yaml]}]"
    assert names(tmp_path, text) == ["n/a/one", "n/a/two", "n/b/one", "n/b/two"]
    text = "jobs: [{name: n, log: logs/a.mcap, config: [one.yaml]}]"
    assert names(tmp_path, text) == ["n/one"]


def test_patterns_are_relative_to_the_file_and_brackets_in_its_folder_are_plain(tmp_path):
    base = tmp_path / "set [1]"
    touch(base, "logs/a.mcap")
    assert names(base, "jobs: [{name: n, log: 'logs/*'}]") == ["n/a"]


def test_what_exists_under_the_very_name_is_no_pattern(tmp_path):
    touch(tmp_path, "run[1].mcap")
    [job] = read(tmp_path, "jobs: [{name: n, log: 'run[1].mcap'}]")
    assert job.name == "n"
    assert Path(job.log).exists()


def test_a_jobs_file_may_be_named_from_its_own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("jobs.yaml").write_text("jobs: [{name: n, log: a.mcap}]")
    [job] = read_jobs(Path("jobs.yaml"))
    assert job.log == str(tmp_path / "a.mcap")  # workers may stand elsewhere


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("log.carmen.gz", "log"),
        ("a.mcap", "a"),
        ("a.b.bag", "a.b"),
        ("bag_folder", "bag_folder"),
        ("odd.xyz", "odd"),
        ("2026.11.22.mcap", "2026.11.22"),
    ],
)
def test_endings_of_logs(name, stem):
    assert without_ending(name) == stem


# --- values ---


def test_defaults_hold_where_a_job_says_nothing(tmp_path):
    touch(tmp_path, "t.tum", "r.txt")
    (tmp_path / "c.yaml").write_text("segmentation: {min_points: 7}\n")
    text = """
defaults: {config: c.yaml, trajectory: t.tum, limits: [ate_rmse<=0.2], time_limit: 90}
jobs:
  - {name: a, log: a.mcap}
  - {name: b, log: b.mcap, limits: ['ate_rmse < 0.1'], time_limit: 10m, memory_limit: 1.5GB}
  - {name: c, log: c.mcap, trajectory: null, relations: r.txt}
"""
    a, b, c = read(tmp_path, text)
    assert a.config.values["segmentation"]["min_points"] == 7
    assert (a.trajectory, a.limits) == (str(tmp_path / "t.tum"), ("ate_rmse<=0.2",))
    assert (a.time_limit, a.memory_limit) == (90.0, None)
    assert (b.limits, b.time_limit, b.memory_limit) == (("ate_rmse < 0.1",), 600.0, 1_500_000_000)
    assert (c.trajectory, c.relations) == (None, str(tmp_path / "r.txt"))
    assert a.config is b.config  # read once


def test_what_belongs_to_each_log_is_found_beside_it(tmp_path):
    for place in "xy":
        touch(tmp_path, f"{place}/log.mcap", f"{place}/truth.tum", f"{place}/log.json")
    text = """
defaults: {trajectory: '{folder}/truth.tum', reference: '{folder}/{stem}.json'}
jobs: [{name: n, log: '*/log.mcap'}]
"""
    x, y = read(tmp_path, text)
    assert x.trajectory == str(tmp_path / "x" / "truth.tum")
    assert y.reference == str(tmp_path / "y" / "log.json")


def test_a_configuration_is_known_by_its_values(tmp_path):
    (tmp_path / "a.yaml").write_text("# a comment\nsegmentation: {min_points: 7}\n")
    (tmp_path / "b.yaml").write_text("segmentation:\n  min_points: 7\n")
    a, b = read(tmp_path, "jobs: [{name: n, log: a.mcap, config: [a.yaml, b.yaml]}]")
    assert a.config.digest == b.config.digest


@pytest.mark.parametrize(
    ("text", "seconds"), [(5, 5.0), ("90", 90.0), ("90s", 90.0), ("1.5h", 5400.0), ("2 min", 120.0)]
)
def test_durations(text, seconds):
    assert parse_seconds(text) == seconds


@pytest.mark.parametrize(
    ("text", "size"), [(4096, 4096), ("500MB", 500_000_000), ("2 GiB", 2 << 30), ("1k", 1000)]
)
def test_sizes(text, size):
    assert parse_bytes(text) == size


@pytest.mark.parametrize("text", ["", "x", "-1", "0", "1 parsec", "1e400", True, float("nan")])
def test_what_is_no_quantity(text):
    with pytest.raises(ValueError, match="write"):
        parse_seconds(text)
    with pytest.raises(ValueError, match="write"):
        parse_bytes(text)


def test_quantities_for_a_person():
    assert seconds_text(0.00022) == "under 0.1 s"
    assert seconds_text(3.21) == "3.21 s"
    assert seconds_text(250) == "4 min 10 s"
    assert seconds_text(7500) == "2 h 5 min"
    assert bytes_text(1_500_000_000) == "1.5 GB"
    assert bytes_text(64_200_000) == "64.2 MB"


# --- faults ---


def test_every_fault_is_listed_with_its_line_and_path(tmp_path):
    touch(tmp_path, "t.tum")
    (tmp_path / "bad.yaml").write_text("segmentation:\n  min_pts: 7\n")
    found = faults(
        tmp_path,
        """defaults:
  limits: [ate_rmse=0.2]
  time_limit: soon
jobs:
  - {name: a, log: a.mcap, config: bad.yaml}
  - {name: b, log: 'logs/*.mcap'}
  - {name: c, log: c.mcap, trajectory: t.tum, reference: gone.json}
  - {name: ../d, log: d.mcap, memory_limit: 2 parsecs}
  - {name: summary.json, log: d.mcap}
  - {name: f, log: []}
  - {name: g, log: g.mcap, config: []}
  - {name: h, log: h.mcap, relations: 'https://example.org/r.txt'}
""",
    )
    assert [fault.split(": ")[:2] for fault in found] == [
        ["line 2", "defaults.limits[0]"],
        ["line 3", "defaults.time_limit"],
        ["line 5", "jobs[0].config"],
        ["line 6", "jobs[1].log"],
        ["line 7", "jobs[2].reference"],
        ["line 8", "jobs[3].memory_limit"],
        ["line 8", "jobs[3].name"],
        ["line 9", "jobs[4].name"],
        ["line 10", "jobs[5].log"],
        ["line 11", "jobs[6].config"],
        ["line 12", "jobs[7].relations"],
    ]
    assert "bad.yaml: line 2: segmentation.min_pts: unknown key" in found[2]
    assert "no log fits logs/*.mcap" in found[3]
    assert "gone.json: no such file" in found[4]


def test_faults_of_shape_are_listed_too(tmp_path):
    found = faults(tmp_path, "jobs:\n  - {name: a, log: a.mcap, limit: [x<1]}\n  - {name: b}\n")
    assert [fault.split(": ")[1] for fault in found] == ["jobs[0].limit", "jobs[1].log"]
    assert "did you mean limits?" in found[0]


@pytest.mark.parametrize(
    ("jobs", "why"),
    [
        ("[{name: a, log: x.mcap}, {name: a, log: y.mcap}]", "the other is in line 1"),
        ("[{name: a, log: 'logs/*'}]", "logs/r.bag and"),
        ("[{name: a, log: x.mcap, config: [p/c.yaml, q/c.yaml]}]", "one stem"),
    ],
)
def test_two_jobs_of_one_name(tmp_path, jobs, why):
    touch(tmp_path, "logs/r.bag", "logs/r.mcap", "p/c.yaml", "q/c.yaml")
    [fault] = faults(tmp_path, f"jobs: {jobs}")
    assert "two jobs are called a" in fault
    assert why in fault


def test_no_result_lies_in_another(tmp_path):
    touch(tmp_path, "logs/r.mcap")
    [fault] = faults(tmp_path, "jobs: [{name: a, log: x.mcap}, {name: a, log: 'logs/*'}]")
    assert "the results of a/r would lie in those of a (line 1)" in fault


@pytest.mark.parametrize("name", ["/abs", "a//b", ".", "a/../b", ".hidden", "junit.xml", "a\tb"])
def test_names_that_are_no_folders(tmp_path, name):
    assert faults(tmp_path, f"jobs: [{{name: {name!r}, log: x.mcap}}]".replace("'", '"'))


def test_nothing_begins_where_there_is_a_fault(tmp_path):
    touch(tmp_path, "a.mcap")
    jobs = write_jobs(
        tmp_path / "jobs.yaml",
        [{"name": "a", "log": "a.mcap"}, {"name": "a", "log": "a.mcap", "limits": ["x"]}],
    )
    done = batch(jobs, "-o", tmp_path / "out")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 2
    assert not (tmp_path / "out").exists()


def test_ten_thousand_jobs_in_one_file(tmp_path):
    lines = [f"  - {{name: n{i}, log: logs/{i}/log.mcap}}" for i in range(10_000)]
    assert len(names(tmp_path, "\n".join(["jobs:", *lines]))) == 10_000


def test_links_are_named_as_they_are_given(tmp_path):
    touch(tmp_path, "store/1/log.mcap")
    (tmp_path / "logs").symlink_to(tmp_path / "store")
    assert names(tmp_path, "jobs: [{name: n, log: 'logs/*/log.mcap'}]") == ["n/1/log"]
