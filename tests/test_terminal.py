"""What a person sees of a run: a bar and a table on a terminal, few plain lines elsewhere."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console
from samples import sample_result

from hiermap_cli.batch.run_log import RunOutcome
from hiermap_cli.commands import terminal
from hiermap_cli.commands.terminal import (
    Display,
    PlainDisplay,
    TerminalDisplay,
    make_display,
    summary_rows,
)
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
