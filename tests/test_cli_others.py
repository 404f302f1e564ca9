"""`hiermap` itself, `config` and `validate`: help, version, completion, pipes, verdicts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from samples import hiermap, program, write_sample

from hiermap_cli import __version__
from hiermap_cli.batch.run_log import default_output
from hiermap_cli.commands.main import COMMANDS
from hiermap_cli.errors import EXIT_INPUT, EXIT_OK, EXIT_USAGE, UsageError


def test_version_and_help():
    status, out, _ = hiermap("--version")
    assert (status, out.strip()) == (EXIT_OK, f"hiermap, version {__version__}")
    status, out, _ = hiermap("--help")
    assert status == EXIT_OK
    for name in COMMANDS:
        assert f"  {name} " in out


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_helps(name):
    status, out, _ = hiermap(name, "--help")
    assert status == EXIT_OK
    assert out.startswith("Usage: ")


def test_no_command_shows_the_help_and_is_wrong_usage():
    done = program()
    assert done.returncode == EXIT_USAGE
    assert "Commands:" in done.stderr
    assert done.stdout == ""


def test_completion_knows_the_commands():
    environment = {
        **os.environ,
        "_HIERMAP_COMPLETE": "bash_complete",
        "COMP_WORDS": "hiermap ru",
        "COMP_CWORD": "1",
    }
    assert program(env=environment).stdout.split(",")[-1].strip() == "run"
    source = program(env={**os.environ, "_HIERMAP_COMPLETE": "bash_source"})
    assert "complete -o nosort" in source.stdout


def test_a_reader_that_has_seen_enough_is_no_error():
    command = (
        f"{sys.executable} -m hiermap_cli config | head -c 1 > /dev/null; echo ${{PIPESTATUS[0]}}"
    )
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("0", "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_behind_stdout_is_one_line():
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "hiermap_cli", "config"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == EXIT_INPUT
    assert len(done.stderr.splitlines()) == 1
    assert "No space left" in done.stderr


def test_config_prints_what_it_reads(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(hiermap("config")[1])
    assert hiermap("config", "--config", path)[1] == path.read_text()
    path.write_text("laser: {sigma_range: 0.02}")
    assert "sigma_range: 0.02" in hiermap("config", "--config", path)[1]


def test_validate_tells_good_from_bad(tmp_path):
    good, bad, broken = (tmp_path / name for name in ("good.yaml", "bad.yaml", "model.json"))
    good.write_text("segmentation: {min_points: 4}")
    bad.write_text("segmentation: {min_points: 2, typo: 1}")
    broken.write_text("{")
    status, out, err = hiermap("validate", good, bad)
    assert status == EXIT_USAGE
    assert out == f"{good}: valid configuration\n"
    assert len(err.splitlines()) == 2
    status, _, err = hiermap("validate", good, bad, broken)
    assert status == EXIT_INPUT
    assert len(err.splitlines()) == 3


def test_validate_knows_floor_plans_and_jobs(tmp_path):
    world, jobs = tmp_path / "w.yaml", tmp_path / "j.yaml"
    world.write_text("areas: [{id: A, box: [0, 0, 4, 3]}]\nway_points: [[1, 1], [2, 1]]\n")
    jobs.write_text("jobs:\n  - {name: a, log: [x.mcap, y.mcap], limits: ['ate_rmse<=0.2']}\n")
    status, out, _ = hiermap("validate", world, jobs)
    assert status == EXIT_OK
    assert "valid world" in out
    assert "valid jobs" in out
    jobs.write_text("jobs:\n  - {name: a, lgo: x}\n")
    status, _, err = hiermap("validate", jobs)
    assert status == EXIT_USAGE
    assert "did you mean log?" in err


def test_validate_refuses_the_worlds_that_simulate_refuses(tmp_path):
    world = tmp_path / "w.yaml"
    world.write_text(
        "areas:\n  - {id: K, box: [0, 0, 4, 3]}\n  - {id: L, box: [3, 0, 9, 3]}\n"
        "way_points: [[1, 1], [2, 1]]\n"
    )
    status, out, err = hiermap("validate", world)
    assert (status, out) == (EXIT_USAGE, "")
    assert err == f"{world}: line 3: areas[1]: 'K' and 'L' overlap\n"
    status, _, refused = hiermap("simulate", world, "-o", tmp_path / "out")
    assert status == EXIT_USAGE
    assert "line 3: areas[1]: 'K' and 'L' overlap" in refused
    assert not (tmp_path / "out").exists()


def test_validate_knows_limits_and_maps_and_says_which_kinds_there_are(tmp_path):
    limits, grid, other = (tmp_path / name for name in ("l.yaml", "m.yaml", "o.yaml"))
    limits.write_text("limits:\n  - ate_rmse<=0.1\n")
    assert hiermap("validate", limits)[:2] == (EXIT_OK, f"{limits}: valid limits\n")
    limits.write_text("limits:\n  - ate_rmse<=0.1\n  - ate_rmse\n")
    status, _, err = hiermap("validate", limits)
    assert status == EXIT_USAGE
    assert err.startswith(f"{limits}: line 3: limits[1]: 'ate_rmse' is no limit")
    grid.write_text("image: none.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    status, _, err = hiermap("validate", grid)
    assert status == EXIT_INPUT
    assert "no such image" in err
    other.write_text("version: '3'\nservices: {db: {image: x}}\n")
    status, _, err = hiermap("validate", other)
    assert status == EXIT_USAGE
    assert len(err.splitlines()) == 1
    assert "of no kind that is known by its keys (version, services); known are config" in err


def test_validate_says_where_a_number_is_none(tmp_path):
    write_sample(tmp_path)
    report = tmp_path / "report.json"
    document = json.loads(report.read_text())
    document["metrics"][1]["value"] = float("nan")
    report.write_text(json.dumps(document))
    status, _, err = hiermap("validate", report)
    assert status == EXIT_INPUT
    assert err == f"{report}: metrics[1].value: is nan, not a finite number\n"


def test_validate_takes_a_folder_for_the_documents_in_it(tmp_path):
    write_sample(tmp_path)
    (tmp_path / "log.mcap").write_bytes(b"no document")
    status, out, err = hiermap("validate", tmp_path)
    assert (status, err) == (EXIT_OK, "")
    assert len(out.splitlines()) == 6
    (tmp_path / "empty").mkdir()
    status, _, err = hiermap("validate", tmp_path / "empty")
    assert status == EXIT_INPUT
    assert "no document" in err


def test_validate_prints_schemas():
    status, out, _ = hiermap("validate", "--schema", "model")
    assert status == EXIT_OK
    assert json.loads(out)["$id"] == "urn:hiermap:model:1"


def test_default_output_of_a_folder_that_is_named_by_its_place(tmp_path, monkeypatch):
    recording = tmp_path / "recording"
    (recording / "parts").mkdir(parents=True)
    monkeypatch.chdir(recording)
    for name in (".", "./", "parts/.."):
        assert default_output(Path(name)) == tmp_path / "recording.hiermap"
    assert default_output(Path("..")) == tmp_path.with_name(tmp_path.name + ".hiermap")
    with pytest.raises(UsageError, match="-o"):
        default_output(Path("/"))


def test_what_was_not_evaluated_cannot_be_compared(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_sample(tmp_path / name)
    status, out, err = hiermap("compare", tmp_path / "a", tmp_path / "b")
    assert (status, out) == (EXIT_INPUT, "")
    assert "a: holds no eval.json; measure the run with `hiermap eval` first" in err
    assert len(err.splitlines()) == 1
