from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from hypothesis import given
from hypothesis import strategies as st

from hiermap_cli.documents.junit import Case, junit_xml, write_junit


def cases_of(data: bytes) -> list[ET.Element]:
    return list(ET.fromstring(data).iter("testcase"))


def test_passed_failed_broken_and_skipped_cases():
    data = junit_xml(
        "limits",
        [
            Case("a", suite="w1", seconds=1.23456, properties={"ate_rmse": "0.02"}),
            Case("b", failure="ate_rmse is 0.3, wanted <= 0.1"),
            Case("c", error="the log cannot be read", output="line 1\nline 2"),
            Case("d", skipped="not asked for"),
        ],
    )
    suite = next(ET.fromstring(data).iter("testsuite"))
    assert {key: suite.get(key) for key in ("tests", "failures", "errors", "skipped")} == {
        "tests": "4",
        "failures": "1",
        "errors": "1",
        "skipped": "1",
    }
    a, b, c, d = cases_of(data)
    assert (a.get("name"), a.get("classname"), a.get("time")) == ("a", "w1", "1.235")
    assert a.find("properties/property").attrib == {"name": "ate_rmse", "value": "0.02"}
    assert b.find("failure").get("message") == b.find("failure").text
    assert "wanted <= 0.1" in b.find("failure").text
    assert c.find("error").get("message") == "the log cannot be read"
    assert c.find("system-out").text == "line 1\nline 2"
    assert d.find("skipped") is not None


def test_the_same_cases_give_the_same_bytes():
    cases = [Case("a", failure="x"), Case("b", seconds=0.1)]
    assert junit_xml("s", cases) == junit_xml("s", cases)


def test_control_characters_of_a_damaged_log_do_not_spoil_the_report():
    (case,) = cases_of(
        junit_xml("s", [Case("log\x00\x1b[31m", failure="bad \x07 & <byte> \ud800")])
    )
    assert case.get("name") == "log??[31m"
    assert case.find("failure").text == "bad ? & <byte> ?"


@given(st.text(st.characters(codec=None), max_size=30))
def test_any_text_can_be_carried(text):
    (case,) = cases_of(junit_xml(text, [Case(text, suite=text, error=text, output=text)]))
    assert not re.search("[\x00-\x08]", case.get("name"))


def test_a_report_is_written_whole(tmp_path):
    path = tmp_path / "deep" / "junit.xml"
    write_junit(path, "s", [Case("a")])
    assert path.read_bytes() == junit_xml("s", [Case("a")])
    assert [p.name for p in path.parent.iterdir()] == ["junit.xml"]
