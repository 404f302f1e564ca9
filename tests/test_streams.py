"""Streams that are closed, or that cannot carry every letter: no result is lost by them."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys

import pytest
from test_cli import FILES, carmen_log

from hiermap_cli.commands.streams import ClosedOutput
from hiermap_cli.errors import EXIT_INPUT, EXIT_OK, OutputError


def shell(closing: str, *arguments, **environment: str) -> subprocess.CompletedProcess[str]:
    """The program as a shell starts it, with `closing` such as `>&-`."""
    words = shlex.join([sys.executable, "-m", "hiermap_cli", *map(str, arguments)])
    return subprocess.run(
        ["bash", "-c", f"{words} {closing}"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )


@pytest.fixture
def log(tmp_path):
    return carmen_log(tmp_path / "walk.carmen")


@pytest.mark.parametrize("closing", [">&-", "2>&-", "<&-", "<&- >&- 2>&-"])
@pytest.mark.parametrize("quiet", [(), ("-q",)])
def test_what_prints_nothing_needs_no_stream(log, tmp_path, closing, quiet):
    done = shell(closing, "run", log, "-o", tmp_path / "out", *quiet)
    assert done.returncode == EXIT_OK
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == FILES
    assert done.stdout == ""
    assert ("landmarks" in done.stderr) == (not quiet and "2>&-" not in closing)


@pytest.mark.parametrize(
    "arguments",
    [
        ("config",),
        ("validate", "--schema", "model"),
        ("inspect", "LOG"),
        ("inspect", "LOG", "--json"),
        ("--help",),
        ("--version",),
        ("run", "--help"),
    ],
)
def test_what_must_print_and_cannot_is_one_line(log, arguments):
    done = shell(">&-", *(log if word == "LOG" else word for word in arguments))
    assert done.returncode == EXIT_INPUT
    lines = [line for line in done.stderr.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1
    assert lines[0].startswith("hiermap: stdout is closed")


def test_the_results_are_there_where_only_their_summary_cannot_be_printed(log, tmp_path):
    done = shell(">&-", "run", log, "-o", tmp_path / "out", "--json", "-q")
    assert done.returncode == EXIT_INPUT
    assert len(done.stderr.splitlines()) == 1
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == FILES


def test_a_document_that_does_not_hold_keeps_its_status_with_stdout_closed(tmp_path):
    bad = tmp_path / "c.yaml"
    bad.write_text("laser: {sigma_range: -1}\n")
    assert shell(">&-", "validate", bad).returncode == 2
    bad.write_text("laser: {sigma_range: 0.02}\n")
    done = shell(">&-", "validate", bad)
    assert (done.returncode, len(done.stderr.splitlines())) == (EXIT_INPUT, 1)


def test_nothing_said_is_no_fault_of_a_closed_stdout():
    assert ClosedOutput().write(b"") == 0
    with pytest.raises(OutputError, match="stdout is closed"):
        ClosedOutput().write(b"x")


def test_letters_that_a_terminal_lacks_are_escaped(tmp_path):
    log = carmen_log(tmp_path / "Fahrt größe 1.carmen")
    done = shell("", "inspect", log, PYTHONIOENCODING="ascii")
    assert done.returncode == EXIT_OK
    assert "Fahrt gr\\xf6\\xdfe 1.carmen" in done.stdout


def test_a_name_that_is_no_text_is_printed(tmp_path):
    log = carmen_log(tmp_path / "walk.carmen")
    odd = log.rename(tmp_path / os.fsdecode(b"w\xe4lk.carmen"))
    done = shell("", "inspect", odd)
    assert (done.returncode, "Traceback" in done.stderr) == (EXIT_OK, False)
