"""What a person sees of a batch: bars on a terminal, lines elsewhere, nothing where quiet."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
from pathlib import Path

from batch_cases import arguments, batch, jobs_of, small_log, small_logs
from rich.console import Console

from hiermap_cli.batch.job import ConfigChoice, Job, Outcome
from hiermap_cli.batch.summary import Tally
from hiermap_cli.commands.batch_view import (
    PlainView,
    TerminalView,
    make_view,
    outcome_line,
)

JOB = Job("night/a", "a.mcap", ConfigChoice({}, ""))
GOOD = Outcome("night/a", "done", None, 3.21, 64_200_000)
BAD = Outcome("night/b", "failed", "its worker was killed by SIGKILL", 1.0)


def on_terminal(verbose: bool = False) -> tuple[TerminalView, io.StringIO]:
    view, screen = TerminalView(verbose, Path("out")), io.StringIO()
    view._console = Console(
        file=screen, force_terminal=True, width=110, markup=False, highlight=False
    )
    return view, screen


def test_a_terminal_shows_a_bar_for_each_worker():
    view, screen = on_terminal()
    with view:
        view.planned(5, 2, 2)
        view.event(0, JOB, {"pid": 17})
        view.event(0, JOB, {"total": 400, "stage": "mapping"})
        view.event(0, JOB, {"scans": 100})
        view.event(1, JOB._replace(name="x" * 50), {"pid": 18})
        view._progress.refresh()
        view.finished(GOOD)
        view.finished(BAD)
        view.event(0, JOB, {"pid": 17})
        view._progress.refresh()
        view.ended(Tally(4, 0, 1))
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.getvalue())
    assert "5 jobs on 2 workers, 2 done before" in shown
    assert re.search(r"night/a +\S* +100/400 mapping", shown)
    assert re.search(r"\.\.\.x{25} ", shown)  # its end tells most
    assert re.search(r"jobs +\S* +2/5", shown)
    assert "night/b: failed: its worker was killed by SIGKILL, 1 s" in shown
    assert "night/a: done" not in shown  # what goes well is not said
    assert "5 jobs: 4 done, 1 failed" in shown


def test_a_terminal_without_bars_takes_events():
    view, _ = on_terminal()
    view.event(0, JOB, {"pid": 17})
    view.close()
    view.close()


def test_lines_elsewhere(capsys):
    view = PlainView(verbose=False, output=Path("out"))
    view.planned(2, 1, 1)
    view.finished(GOOD._replace(kept=True))
    view.finished(GOOD)
    view.finished(BAD)
    view.finished(BAD._replace(status="limit_missed", reason="areas<=3: it is 4", kept=True))
    view.warned("a\nwarning")
    view.ended(Tally(2, 0, 1))
    lines = capsys.readouterr().err.splitlines()
    assert lines[:5] == [
        "2 jobs on 1 worker, 1 done before",
        "[1/2] night/a: done, 3.21 s, 64.2 MB",
        "[2/2] night/b: failed: its worker was killed by SIGKILL, 1 s",
        "night/b: limit missed, kept: areas<=3: it is 4, 1 s",
        "warning: a warning",
    ]
    assert lines[5].startswith("3 jobs: 2 done, 1 failed, in ")
    assert lines[6] == "results: out"


def test_names_and_reasons_stay_on_one_line():
    assert "\n" not in outcome_line(BAD._replace(reason="a\nb\x1b[31m", name="x\ny"))
    assert "\x1b" not in outcome_line(BAD._replace(reason="a\nb\x1b[31m"))


def test_quiet_names_the_jobs_that_are_not_done(capsys):
    view = make_view(quiet=True, verbose=True, output=Path("out"))
    view.planned(4, 1, 2)
    for outcome in (GOOD, GOOD._replace(kept=True), BAD):
        view.finished(outcome)
    late = GOOD._replace(status="limit_missed", reason="ate_rmse<=1: it is 2", kept=True)
    view.finished(late)
    view.warned("a warning")
    out, err = capsys.readouterr()
    assert not out
    assert err.splitlines() == [f"hiermap: {outcome_line(BAD)}", f"hiermap: {outcome_line(late)}"]


def test_quiet_says_nothing_where_all_is_well(tmp_path):
    log = small_log(tmp_path / "a.log")
    done = batch(jobs_of([log], tmp_path / "jobs.yaml"), "-o", tmp_path / "out", "-q")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_on_a_real_terminal(tmp_path):
    jobs = jobs_of(small_logs(tmp_path, 2), tmp_path / "jobs.yaml")
    master, slave = pty.openpty()
    process = subprocess.Popen(arguments(jobs, "-o", tmp_path / "out"), stderr=slave)
    os.close(slave)
    shown = b""
    try:
        while piece := os.read(master, 4096):
            shown += piece
    except OSError:
        pass  # the terminal ends with its last process
    os.close(master)
    assert process.wait() == 0
    assert b"2 jobs: 2 done" in shown
    assert b"\x1b[" in shown  # bars moved
