"""No command takes away what hiermap did not write, or what it reads: from files to status."""

from __future__ import annotations

import hashlib
import os
import shutil

import click
import pytest
from click.testing import CliRunner
from eval_cases import write_map, write_reference, write_run, write_truth
from samples import hiermap, program
from world_cases import DATASETS

from hiermap_cli.commands.main import COMMANDS, cli
from hiermap_cli.documents.results import REPORT, RESULT
from hiermap_cli.errors import EXIT_INPUT, EXIT_OK, EXIT_USAGE


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A run, its truth, its maps, and notes, in the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    write_run(tmp_path / "run")
    write_truth(tmp_path)
    write_reference(tmp_path)
    write_map(tmp_path)
    (tmp_path / "notes.md").write_text("years of work")
    return tmp_path


def content(folder):
    """All files below a folder, with a digest of each."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def refused(folder, *arguments):
    """What a command says that is wrong usage, in one line, and changes nothing."""
    before = content(folder)
    status, _, said = hiermap(*arguments)
    assert status == EXIT_USAGE, said
    assert len(said.splitlines()) == 1
    assert content(folder) == before
    return said


REPORT_TEXT = '{"format": "hiermap-report", "version": [1, 0]}'
EVAL = ("eval", "run", "--trajectory", "truth.tum", "-q")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("-o", "truth.tum"), "truth.tum: is an input; choose another file with -o"),
        (("--summary", "truth.tum"), "choose another file with --summary"),
        (("--reference", "reference.json", "--overlay", "run/map.svg"), "with --overlay"),
        (("--limits", "limits.yaml", "-o", "limits.yaml"), "limits.yaml: is an input"),
        (("-o", "run/model.json"), "run/model.json: is an input"),
        (("--junit", "run/trajectory.tum"), "run/trajectory.tum: is an input"),
        (("--summary", "notes.md"), "notes.md: exists and is none that --summary writes"),
        (("-o", "notes.md"), "notes.md: exists and is none that -o writes"),
        (("-o", "a", "--summary", "a"), "a: is named by -o and --summary"),
        (("--summary", "a", "--junit", "./a"), "is named by --summary and --junit"),
        (("--summary", "run/eval.json"), "run/eval.json: is named by -o and --summary"),
        (("-o", "run"), "run: is a folder; name a file with -o"),
        (("--summary", "notes.md/a"), "choose another place with --summary"),
    ],
)
def test_eval_writes_over_nothing_of_others(place, arguments, said):
    (place / "limits.yaml").write_text("limits: []\n")
    assert said in refused(place, *EVAL, *arguments)


def test_eval_writes_over_what_it_wrote(place):
    more = ("--reference", "reference.json", "--summary", "a.md", "--junit", "a.xml")
    for _ in range(2):
        assert hiermap(*EVAL, *more, "--overlay", "a.svg")[0] == EXIT_OK
    assert (place / "notes.md").read_text() == "years of work"


def test_the_summary_of_a_ci_job_is_added_to_even_if_it_is_named(place, monkeypatch):
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(place / "notes.md"))
    assert hiermap(*EVAL, "--summary", "notes.md")[0] == EXIT_OK
    text = (place / "notes.md").read_text()
    assert text.startswith("years of work### hiermap eval")
    assert text.count("### hiermap eval") == 1


def test_compare_writes_over_nothing_of_others(place):
    assert hiermap(*EVAL)[0] == EXIT_OK
    for name in ("run/eval.json", "notes.md", "run/model.json"):
        assert "--summary" in refused(place, "compare", "run", "run", "-q", "--summary", name)
        assert "--junit" in refused(place, "compare", "run", "run", "-q", "--junit", name)


@pytest.mark.parametrize(
    ("output", "said"),
    [
        ("map.yaml", "map.yaml: is an input"),
        ("rooms.png", "rooms.png: is an input"),
        ("truth.tum", "truth.tum: is an input"),
        ("map.png", "map.png: exists and is none that -o writes"),
        ("run", "run: is a folder; name a file"),
    ],
)
@pytest.mark.parametrize("force", [(), ("--force",)])
def test_reference_writes_over_nothing_of_others(place, output, said, force):
    arguments = ("map.yaml", "--rooms", "rooms.png", "--trajectory", "truth.tum", *force)
    assert said in refused(place, "reference", *arguments, "-o", output)


@pytest.mark.parametrize(
    ("output", "said"),
    [
        ("k", "k: holds data, which is no part of an earlier result"),
        ("parent", "parent: holds below, which"),
        ("keras", "keras: holds a model.json that hiermap did not write"),
        ("notes.md", "notes.md: is a file, not a folder"),
        (".", "holds the input log.log"),
    ],
)
@pytest.mark.parametrize("force", [(), ("--force",)])
def test_run_takes_nothing_of_others_away(place, output, said, force):
    (place / "k" / "data").mkdir(parents=True)
    (place / "k" / "data" / "train.csv").write_text("d")
    (place / "k" / "model.json").write_text('{"class_name": "Sequential"}')
    shutil.copytree(place / "run", place / "parent" / "below")
    (place / "parent" / "report.json").write_text(REPORT_TEXT)
    shutil.copytree(place / "run", place / "keras")
    (place / "keras" / "model.json").write_text('{"class_name": "Sequential"}')
    (place / "log.log").write_text("")
    answer = refused(place, "run", "log.log", "-o", output, *force)
    assert said in answer
    assert "--force replaces it" not in answer


def test_what_a_run_and_its_evaluation_write_is_all_known(place):
    assert hiermap(*EVAL)[0] == EXIT_OK
    (place / "run" / REPORT).write_text(REPORT_TEXT)
    assert {path.name for path in (place / "run").iterdir()} == set(RESULT.files)
    assert RESULT.fault(place / "run") is None


def test_simulate_takes_nothing_of_others_away(place):
    world = DATASETS / "room.yaml"
    arguments = ("simulate", world, "-q", "-o")
    (place / "rec").mkdir()
    assert hiermap(*arguments, "rec")[0] == EXIT_OK  # an empty folder is used
    assert "exists already; --force replaces it" in refused(place, *arguments, "rec")
    (place / "rec" / "log.hiermap").mkdir()  # a run without -o leaves its result here
    assert "holds log.hiermap, which" in refused(place, *arguments, "rec", "--force")
    (place / "rec" / "log.hiermap").rmdir()
    (place / "rec" / "log.mcap").write_bytes(b"\x89MCAP0\r\n\x01 of another program")
    said = refused(place, *arguments, "rec", "--force")
    assert "holds a log.mcap that hiermap did not write" in said


def test_a_simulation_is_replaced_with_force(place):
    arguments = ("simulate", DATASETS / "room.yaml", "-q", "-o", "rec")
    assert hiermap(*arguments)[0] == EXIT_OK
    before = content(place / "rec")
    assert hiermap(*arguments, "--seed", "2", "--force")[0] == EXIT_OK
    assert content(place / "rec").keys() == before.keys()
    assert content(place / "rec") != before


# --- what may not be read, or not be written ---


def test_no_command_lets_the_parser_judge_what_can_be_read():
    """Click's own check would make unreadable inputs wrong usage."""
    asked = 0
    for name in set(COMMANDS) - {"inspect"}:  # whose configuration alone it judges
        for parameter in cli.get_command(None, name).params:
            if isinstance(parameter.type, click.Path):
                assert not parameter.type.readable, (name, parameter.name)
                asked += 1
    assert asked > 20


@pytest.mark.parametrize("output", ["x.mcap", "none/x.mcap"])
def test_convert_says_where_it_cannot_write(place, monkeypatch, output):
    (place / "log.log").write_text("")
    monkeypatch.setattr(os, "access", lambda *_: False)  # as on a disk that is read-only
    said = refused(place, "convert", "log.log", "-o", output)
    assert "choose another place with -o" in said or "there is no folder none" in said


def test_an_empty_path_is_wrong_usage(tmp_path):
    for arguments in (("run", ""), ("run", "log.mcap", "-o", ""), ("config", "--config", "")):
        done = program(*arguments, cwd=tmp_path)
        assert done.returncode == EXIT_USAGE
        assert "is empty; a file or a folder must have a name" in done.stderr
        assert len(done.stderr.splitlines()) == 1


@pytest.mark.usefixtures("place")
def test_what_the_system_keeps_from_us_is_no_fault_of_the_program(monkeypatch):
    def closed(*_):
        raise PermissionError(13, "Permission denied", "run/trajectory.tum")

    monkeypatch.setattr("hiermap_cli.batch.evaluate_run.read_tum", closed)
    done = CliRunner().invoke(cli, list(EVAL))
    assert done.exit_code == EXIT_INPUT
    assert done.stderr == "hiermap: run/trajectory.tum: cannot be used (Permission denied)\n"
