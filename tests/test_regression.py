from __future__ import annotations

import pytest

from hiermap_cli.documents.eval_file import EvalDocument
from hiermap_cli.errors import UsageError
from hiermap_cli.evaluation.regression import compare, parse_rule
from hiermap_cli.mapping.model import Metric


def document(**values: float) -> EvalDocument:
    return EvalDocument(tuple(Metric(name, "m", value, 1) for name, value in values.items()))


@pytest.mark.parametrize(
    ("rule", "before", "after", "passed"),
    [
        ("a>5%", 1.0, 1.05, True),
        ("a>5%", 1.0, 1.0501, False),
        ("a>5%", 1.0, 0.5, True),
        ("a<-5%", 1.0, 0.95, True),
        ("a<-5%", 1.0, 0.9499, False),
        ("a>0%", 1.0, 1.0, True),
        ("a>5%", 0.0, 0.0, True),
        ("a>5%", 0.0, 1e-9, False),
        ("a>5%", -1.0, -0.9, False),
        ("a>+0.02", 1.0, 1.02, True),
        ("a>+0.02", 1.0, 1.021, False),
        ("a<-0.02", 1.0, 0.97, False),
        ("a>0.1", 5.0, 0.1, True),
        ("a>0.1", 0.0, 0.11, False),
        ("a>=1e-1", 0.0, 0.1, False),
    ],
)
def test_rules(rule, before, after, passed):
    comparison = compare(document(a=before), document(a=after), [parse_rule(rule)])
    assert comparison.passed is passed


def test_what_one_of_them_lacks_fails():
    rules = [parse_rule("a>5%")]
    for before, after, said in (
        (document(a=1.0), document(b=1.0), "not measured in the candidate"),
        (document(b=1.0), document(a=1.0), "not measured in the baseline"),
        (document(), document(), "not measured in the candidate"),
    ):
        (outcome,) = compare(before, after, rules).outcomes
        assert not outcome.passed
        assert said in outcome.said


def test_a_new_metric_can_be_held_to_a_value():
    comparison = compare(document(), document(a=1.0), [parse_rule("a>2")])
    assert comparison.passed
    (row,) = comparison.rows
    assert (row.baseline, row.candidate, row.change, row.relative) == (None, 1.0, None, None)


@pytest.mark.parametrize("text", ["", "a", "a>", "a>x%", ">5%", "a=5%", "a>5%%", "a>nan"])
def test_no_rule(text):
    with pytest.raises(UsageError, match="is no condition to fail by"):
        parse_rule(text)


@pytest.mark.parametrize("text", ["a<5%", "a>-5%", "a<+0.1", "a>-0.1"])
def test_a_rule_that_fails_without_any_change_is_refused(text):
    with pytest.raises(UsageError, match="would fail without any change"):
        parse_rule(text)
