"""Results of cases as text, as JUnit XML, and as GitHub shows them.

References
----------
"Workflow commands for GitHub Actions", docs.github.com: ``::error file=,line=,title=::message``,
and Markdown appended to the file that ``GITHUB_STEP_SUMMARY`` names.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from quatprop.rendering import count_text
from quatprop.text import plain
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import output_errors

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from quatprop.check.case import CaseResult, Verdict

VERDICTS: Mapping[Verdict, tuple[str, str, str]] = {
    "pass": ("pass", "passed", "passed"),
    "fail": ("FAIL", "failed", ":x: failed"),
    "error": ("ERROR", "errors", ":warning: error"),
    "skip": ("skip", "skipped", "skipped"),
    "xfail": ("xfail", "failed as expected", "failed as expected"),
    "xpass": ("XPASS", "passed unexpectedly", ":warning: passed unexpectedly"),
}
"""Verdict -> how it is written before a case, after a count, and on GitHub."""

JUNIT_ELEMENTS: Mapping[Verdict, str] = {
    "fail": "failure", "error": "error", "skip": "skipped", "xfail": "skipped",
}  # fmt: skip
"""Verdict -> element of JUnit XML."""

NEEDS_ATTENTION: frozenset[Verdict] = frozenset({"fail", "error", "xpass"})
"""Verdicts that somebody has to look at."""

WIDTH = max(len(shown) for shown, *_ in VERDICTS.values())


def result_text(result: CaseResult, width: int) -> str:
    """Return the result of a case: one line, and its reason and changes below."""
    summary = result.summary
    if result.updated is not None and result.verdict != "error":
        summary = f"{result.updated:<7}  {summary}"
    name = f"{plain(result.name):<{width}}"
    first = f"{VERDICTS[result.verdict][0]:<{WIDTH}}  {name}  {summary or plain(result.reason)}"
    indent = " " * (WIDTH + 2)
    below = _details(result) if summary else _details(result)[1:]
    return "\n".join([first.rstrip(), *(f"{indent}{plain(text)}" for text in below)])


def _details(result: CaseResult) -> list[str]:
    """Return the reason and the changes."""
    return [*([result.reason] if result.reason else []), *result.changes]


def note_lines(results: Sequence[CaseResult], *, remarks: bool = False) -> Iterator[str]:
    """Yield each note once, with the number of its cases; those of a failure are in its reason.

    `remarks`: whether those on logs are notes, too
    """
    names: dict[str, list[str]] = {}
    for result in results:
        for note in () if result.verdict in {"fail", "error"} else result.notes:
            names.setdefault(note, []).append(plain(result.name))
        for remark in result.remarks if remarks else ():
            names.setdefault(remark, []).append(plain(result.name))
    for note, cases in names.items():
        yield f"note on {cases[0] if len(cases) == 1 else f'{len(cases)} cases'}: {plain(note)}"


def worst_first(results: Iterable[CaseResult]) -> list[CaseResult]:
    """Return results in the order in which somebody should look at them."""
    order: list[Verdict] = ["error", "fail", "xpass", "xfail", "pass", "skip"]
    return sorted(
        results, key=lambda result: (order.index(result.verdict), -(result.error_rad or 0.0))
    )


def totals(results: Sequence[CaseResult]) -> str:
    """Return how many cases passed, failed, and had errors."""
    verdicts = [result.verdict for result in results]
    texts = [
        f"{count} {text.removesuffix('s') if count == 1 else text}"
        for verdict, (_, text, _) in VERDICTS.items()
        if (count := verdicts.count(verdict)) or verdict == "pass"
    ]
    return f"{count_text(len(results), 'case')}: {', '.join(texts)}"


def write_junit(target: Path | str, suite: Path, results: Sequence[CaseResult]) -> None:
    """Write results as JUnit XML."""
    verdicts = [result.verdict for result in results]
    counts = {
        "tests": str(len(results)),
        "failures": str(verdicts.count("fail")),
        "errors": str(verdicts.count("error")),
        "skipped": str(verdicts.count("skip") + verdicts.count("xfail")),
        "time": f"{sum(result.seconds for result in results):.3f}",
    }
    root = ET.Element("testsuites", counts)
    tests = ET.SubElement(root, "testsuite", {"name": plain(suite.name), **counts})
    for result in results:
        facts = {
            "classname": plain(suite.stem),
            "name": plain(result.name),
            "file": plain(suite.as_posix()),
            "line": str(result.line),
            "time": f"{result.seconds:.3f}",
        }
        case = ET.SubElement(tests, "testcase", facts)
        if result.verdict in JUNIT_ELEMENTS:
            reason = plain(result.reason)
            element = ET.SubElement(case, JUNIT_ELEMENTS[result.verdict], {"message": reason})
            element.text = "\n".join(filter(None, [result.summary, reason]))
        elif texts := [*filter(None, [result.summary, *_details(result), *result.notes])]:
            ET.SubElement(case, "system-out").text = "\n".join(map(plain, texts))
    ET.indent(root)
    with open_atomic(target) as stream:
        ET.ElementTree(root).write(stream, encoding="utf-8", xml_declaration=True)
        stream.write(b"\n")


def append_github_summary(target: str, suite: Path, results: Sequence[CaseResult]) -> None:
    """Append a table of results to the summary of a step on GitHub."""
    rows = [f"### {_markdown(suite.as_posix())}: {totals(results)}", ""]
    rows += ["| case | verdict | worst error | why |", "|---|---|---|---|"]
    for result in worst_first(results):
        why = result.reason or "; ".join([*result.changes, *result.notes])
        cells = [result.name, VERDICTS[result.verdict][2], result.summary, why]
        rows.append(f"| {' | '.join(map(_markdown, cells))} |")
    with output_errors(target), Path(target).open("a", encoding="utf-8") as stream:
        stream.write("\n".join(rows) + "\n\n")


def github_annotations(suite: Path, results: Sequence[CaseResult]) -> Iterator[str]:
    """Yield a line for each case that did not pass, which GitHub shows beside the suite."""
    for result in results:
        if result.verdict in {"fail", "error"}:
            where = f"file={_property(suite.as_posix())},line={result.line}"
            title = _property(f"{result.name}: {result.verdict}")
            message = "; ".join(filter(None, [result.summary, result.reason]))
            yield f"::error {where},title={title}::{_message(message)}"


def _markdown(text: str) -> str:
    """Return text that a cell of a Markdown table shows as it is."""
    text = plain(text)
    for mark in "\\`*_[]<>|":
        text = text.replace(mark, "\\" + mark)
    return text


def _message(text: str) -> str:
    return plain(text).replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _message(text).replace(":", "%3A").replace(",", "%2C")
