from __future__ import annotations

import pytest

from hiermap_cli.errors import UsageError
from hiermap_cli.evaluation.limits import judge_limits, parse_limit


@pytest.mark.parametrize(
    ("text", "value", "holds"),
    [
        ("ate_rmse<=0.10", 0.1, True),
        ("ate_rmse<=0.10", 0.1000001, False),
        ("ate_rmse < 1e-1", 0.1, False),
        (" door_recall>=0.9 ", 0.9, True),
        ("door_recall>0.9", 0.9, False),
        ("relations_missing==0", 0.0, True),
        ("ate_rmse<=0.1", None, False),
    ],
)
def test_limits_hold_or_not(text, value, holds):
    limit = parse_limit(text)
    assert limit.holds(value) is holds
    values = {} if value is None else {limit.metric: value}
    (outcome,) = judge_limits([limit], values)
    assert (outcome.passed, outcome.value, outcome.limit) == (holds, value, limit.bound)
    assert outcome.text == text.strip()


@pytest.mark.parametrize(
    "text",
    ["", "ate_rmse", "ate_rmse<=", "<=1", "ate_rmse<=abc", "a<=nan", "a<=inf", "a<=1 2", "a=<1"],
)
def test_what_is_no_limit_is_refused_with_its_text(text):
    with pytest.raises(UsageError, match="is no limit") as caught:
        parse_limit(text)
    assert repr(text) in str(caught.value)
