"""JUnit XML, as CI systems read it: one suite of cases that passed, failed or broke."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NamedTuple

from hiermap_cli.documents.folder import output_file

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

# What XML 1.0 has no way to carry: control characters, halves of surrogates, non-characters.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class Case(NamedTuple):
    """One test case of a report.

    failure: why it did not pass; error: why it could not be decided at all; skipped: why it was
    not run. At most one of them is given. seconds: how long it took. output: text for a person.
    properties: names and values of figures.
    """

    name: str
    suite: str = "hiermap"
    failure: str | None = None
    error: str | None = None
    skipped: str | None = None
    seconds: float | None = None
    output: str = ""
    properties: Mapping[str, str] | None = None


def xml_text(text: str) -> str:
    """The text without what XML cannot carry; each such character becomes a question mark."""
    return _NOT_XML.sub("?", text)


def junit_xml(name: str, cases: Iterable[Case]) -> bytes:
    """A report with one suite `name`; the same cases give the same bytes."""
    from junitparser import Error, Failure, JUnitXml, Skipped, TestCase, TestSuite
    from junitparser.junitparser import Properties, Property

    suite: Any = TestSuite(xml_text(name))
    for case in cases:
        written: Any = TestCase(xml_text(case.name), classname=xml_text(case.suite))
        if case.seconds is not None:
            written.time = round(case.seconds, 3)
        if case.properties:
            properties: Any = Properties()  # type: ignore[no-untyped-call]
            for key, value in case.properties.items():
                properties.add_property(Property(xml_text(key), xml_text(value)))
            written.append(properties)
        for kind, reason in (
            (Failure, case.failure),
            (Error, case.error),
            (Skipped, case.skipped),
        ):
            if reason is not None:
                outcome = kind(xml_text(reason))
                outcome.text = xml_text(reason)
                written.result = [outcome]
        if case.output:
            written.system_out = xml_text(case.output)
        suite.append(written)  # add_testcase would count all cases anew for each
    suite.update_statistics()
    report: Any = JUnitXml(xml_text(name))
    report.add_testsuite(suite)
    report.update_statistics()
    text: bytes = report.tostring()
    return text + b"\n"


def write_junit(path: Path, name: str, cases: Iterable[Case], option: str = "-o") -> None:
    """Writes a JUnit report, whole or not at all; `option` chose its place.

    Raises:
        UsageError: it cannot be written there.
        OutputError: the disk is full or fails.
    """
    data = junit_xml(name, cases)
    with output_file(path, option) as temporary:
        temporary.write_bytes(data)
