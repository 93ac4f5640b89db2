"""Outcomes as JUnit XML, which every CI service shows."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from quatprop.text import plain
from quatprop.writers.atomic import replacing

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from quatprop.check.case import Outcome

TAGS = {"fail": "failure", "error": "error"}
"""Verdict -> the element that says so."""


def write_junit(target: Path | str, suite: Path, outcomes: Sequence[Outcome]) -> None:
    """Write outcomes as JUnit XML.

    Parameters
    ----------
    target
        Where to write.
    suite
        The suite, whose name is that of the test suite.
    outcomes
        What came of each case.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    verdicts = [outcome.verdict for outcome in outcomes]
    counts = {
        "tests": str(len(outcomes)),
        "failures": str(verdicts.count("fail")),
        "errors": str(verdicts.count("error")),
        "skipped": "0",
        "time": f"{sum(outcome.seconds for outcome in outcomes):.3f}",
    }
    root = ET.Element("testsuites", counts)
    tests = ET.SubElement(root, "testsuite", {"name": plain(suite.name), **counts})
    for outcome in outcomes:
        case = ET.SubElement(
            tests,
            "testcase",
            {
                "classname": plain(suite.stem),
                "name": plain(outcome.name),
                "file": plain(suite.as_posix()),
                "line": str(outcome.line),
                "time": f"{outcome.seconds:.3f}",
            },
        )
        if outcome.verdict in TAGS:
            words = plain(outcome.reason)
            why = ET.SubElement(case, TAGS[outcome.verdict], {"message": words})
            why.text = "\n".join(filter(None, [outcome.figure, words]))
        elif said := "\n".join(filter(None, [outcome.figure, *map(plain, outcome.notes)])):
            ET.SubElement(case, "system-out").text = said
    ET.indent(root)
    with replacing(target) as stream:
        ET.ElementTree(root).write(stream, encoding="utf-8", xml_declaration=True)
        stream.write(b"\n")
