"""What a person sees of a run: a bar and a table on a terminal, few plain lines elsewhere."""

from __future__ import annotations

import io
import itertools
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console
from rich.text import Text
from samples import sample_result

from hiermap_cli.batch.run_log import RunOutcome
from hiermap_cli.commands import inspect, terminal
from hiermap_cli.commands.bars import parts_of, progress_bars
from hiermap_cli.commands.terminal import (
    Display,
    PlainDisplay,
    TerminalDisplay,
    make_display,
    summary_rows,
    verbose_lines,
)
from hiermap_cli.logs.audit import AuditReport, TopicAudit
from hiermap_cli.mapping.metrics import metric, model_metrics, trajectory_metrics


@pytest.fixture
def outcome():
    result = sample_result()
    tracks = trajectory_metrics(
        result.trajectory, result.trajectory_filter, result.trajectory_filter.poses
    )
    return RunOutcome(
        output=Path("out"),
        log="a [red]log[/red].mcap",
        scans=50,
        metrics=(*result.metrics, *model_metrics(result.model), *tracks),
        events=result.events,
        timing={"filter": 0.5, "total": 2.0},
        warnings=("w",),
    )


def on_terminal(verbose: bool = False) -> tuple[TerminalDisplay, io.StringIO]:
    display, screen = TerminalDisplay(verbose), io.StringIO()
    display._console = Console(
        file=screen, force_terminal=True, width=110, markup=False, highlight=False
    )
    return display, screen


def test_a_terminal_shows_bar_rate_time_left_and_table(outcome):
    display, screen = on_terminal()
    with display:
        display.opened(outcome.log, 100)
        display.warned("the laser looks back\nwards")
        display.advanced(20)
        display.advanced(20)
        display._progress.refresh()
        display.entered("refining")
        display._progress.refresh()
        display.finish(outcome)
    shown = screen.getvalue()
    assert "40/100" in shown
    assert "scans/s" in shown
    assert "0:00:0" in shown  # the time that is left
    assert "refining" in shown
    assert "the laser looks back wards" in shown
    assert "a [red]log[/red].mcap" in shown  # the name of a log is no markup
    for name, _ in summary_rows(outcome):
        assert name in shown


def test_a_terminal_shows_a_bar_without_a_known_length(outcome):
    display, screen = on_terminal(verbose=True)
    with display:
        display.opened(outcome.log, None)
        display.advanced(7)
        display._progress.refresh()
        display.finish(outcome)
    assert "7/?" in screen.getvalue()
    assert "area_entered" in screen.getvalue()


def test_a_bar_is_taken_away_when_a_run_fails():
    display, screen = on_terminal()
    with pytest.raises(RuntimeError), display:
        display.opened("log", 10)
        raise RuntimeError
    assert display._progress is None
    assert screen.getvalue().endswith("\x1b[2K")  # the line of the bar is erased


def test_plain_lines_come_now_and_then(monkeypatch, capsys):
    times = iter([0.0, 1.0, 9.0, 11.0, 12.0])
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(times))
    display = PlainDisplay(verbose=False)
    for _ in range(4):
        display.advanced(100)
    assert capsys.readouterr().err == "300 scans done, 27 a second\n"


def test_the_display_fits_where_stderr_goes(monkeypatch, outcome, capsys):
    quiet = make_display(quiet=True, verbose=False)
    assert type(quiet) is Display
    quiet.opened("log", 10)
    quiet.warned("w")
    quiet.finish(outcome)
    assert capsys.readouterr().err == ""
    assert isinstance(make_display(quiet=False, verbose=False), PlainDisplay)
    monkeypatch.setattr(terminal.sys.stderr, "isatty", lambda: True, raising=False)
    assert isinstance(make_display(quiet=False, verbose=False), TerminalDisplay)


def test_the_summary_says_what_was_asked_for(outcome):
    rows = dict(summary_rows(outcome))
    assert rows["areas"] == "2: 1 room, 1 corridor"
    assert rows["landmarks"] == "4: 1 corner_concave, 1 corner_convex, 2 door"
    assert rows["doors"] == "1, 2 crossings"
    assert rows["matches"] == "120"
    assert rows["failures"] == "3 scans that matched nothing known"
    assert rows["time"] == "2.0 s, 40.00 ms a scan"
    assert "at the end" in rows["odometry error corrected"]


def test_metrics_have_a_public_name_and_units():
    assert metric("nis_mean", 1, 2).units == "1"
    assert metric("path_length", 1, 2).units == "m"
    with pytest.raises(KeyError):
        metric("something_else", 1, 2)


def test_correction_of_odometry_is_measured_from_the_first_pose(outcome):
    # The odometry of this outcome is the trajectory one centimetre beside it: nothing to correct
    # but what turning that centimetre makes.
    assert outcome.values()["odometry_correction_end"] < 0.03
    assert outcome.values()["odometry_correction_end_rot"] < 1e-9


@pytest.mark.parametrize("width", [30, 40, 60, 80, 110, 200])
def test_the_count_is_whole_on_any_terminal(width):
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=width)
    with progress_bars(console, "rate") as progress:
        progress.add_task("a_log_of_a_long_name" * 5 + ".mcap", total=123456, rate="99999 scans/s")
        progress.advance(progress.tasks[0].id, 123455)
        progress.refresh()
    shown = [Text.from_ansi(line).plain for line in screen.getvalue().split("\n")]
    assert "123455/123456" in "".join(shown)
    assert max(map(len, "".join(shown).split("\r"))) <= width


def test_the_wider_a_terminal_the_more_of_a_bar():
    parts = [parts_of(width) for width in range(20, 240)]
    for narrow, wide in itertools.pairwise(parts):
        assert (wide.left, wide.said) >= (narrow.left, narrow.said)
    assert not any((parts[0].bar, parts[0].said, parts[0].left))
    assert (parts[-1].bar, parts[-1].said, parts[-1].left) == (40, True, True)


ODD_TOPICS = (
    TopicAudit("/s", "sensor_msgs/msg/LaserScan", "", "scans", 123456, 3, None, None, 12.5, 0.25),
    TopicAudit(
        "/base/odometry/filtered",
        "nav_msgs/msg/Odometry",
        "",
        "odometry",
        9,
        0,
        None,
        None,
        5.0,
        0.2,
    ),
)


@pytest.mark.parametrize("width", [30, 36, 40, 50, 60, 70, 80, 90, 120])
def test_inspect_keeps_every_topic_whole_on_any_terminal(width, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setattr(inspect.sys.stdout, "isatty", lambda: True, raising=False)
    report = AuditReport("log", "MCAP", ("log",), "", ODD_TOPICS, None, None, (), ())
    inspect._show(report)
    lines = [Text.from_ansi(line).plain for line in capsys.readouterr().out.splitlines()]
    assert max(map(len, lines)) <= width
    assert not any("\u2026" in line for line in lines)  # nothing is cut
    words = [line.split() for line in lines]
    assert "/base/odometry/filtered" in "".join(row[0] for row in words if row)
    assert any("/s " in line and "123456" in line for line in lines)
    said = " ".join(lines)
    for name in ("type", "kind", "Hz", "longest gap s", "unreadable"):
        assert all(word in said for word in name.split())  # as a column, or as one not shown


def test_totals_are_told_apart_from_the_stages(outcome):
    timing = {"filter": 0.5, "processor": 1.5, "total": 2.0}
    lines = verbose_lines(replace(outcome, events=(), timing=timing))
    assert [line.strip() for line in lines] == [
        "0.500 s  in filter",
        "1.500 s  of the processor in all",
        "2.000 s  by the clock in all",
    ]
