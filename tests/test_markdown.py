from __future__ import annotations

import math

import pytest

from hiermap_cli.documents.markdown import figure, markdown_table, markdown_text


def test_a_table():
    text = markdown_table(["metric", "value"], [["ate_rmse", "0.1"], ["a|b", "2"]], numbers=[1])
    assert text == ("| metric | value |\n| --- | ---: |\n| ate_rmse | 0.1 |\n| a\\|b | 2 |\n")


def test_marks_and_line_breaks_are_taken_away():
    assert markdown_text("a\nb\x1b <img> `x` *y* [z](u)") == (
        "a b &lt;img&gt; \\`x\\` \\*y\\* \\[z](u)"
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (math.nan, "-"),
        (0.0, "0"),
        (0.0123456, "0.01235"),
        (123.456, "123.5"),
        (1685.0, "1685"),
        (0.5, "0.5"),
        (-2.0, "-2"),
        (1e-7, "1.000e-07"),
    ],
)
def test_figures(value, text):
    assert figure(value) == text
