"""Results of cases as text, as JUnit XML, and as GitHub annotations and summaries.

References
----------
"Workflow commands for GitHub Actions", docs.github.com: ``::error file=,line=,title=::message``, of
which ten of a kind are shown for a step, and Markdown appended to the file that
``GITHUB_STEP_SUMMARY`` names, 1 MiB at most.

junit-10.xsd of the xUnit plugin of Jenkins, which pytest also conforms to: cases have no line and
no file, and the root element has no count of skipped cases.
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
    "deleted": ("gone", "deleted", ":warning: deleted"),
}
"""Verdict -> its text before a case, after a count, and on GitHub."""

JUNIT_ELEMENTS: Mapping[Verdict, str] = {
    "fail": "failure", "error": "error", "skip": "skipped", "xfail": "skipped",
    "deleted": "skipped",
}  # fmt: skip
"""Verdict -> element of JUnit XML."""

NEEDS_ATTENTION: frozenset[Verdict] = frozenset({"fail", "error", "xpass", "deleted"})
"""Verdicts that need attention."""

MAX_ANNOTATIONS = 10
"""Annotations of a kind that GitHub shows for a step."""

MAX_SUMMARY = 1_000_000
"""Most bytes of a summary; GitHub does not show one above 1 MiB."""

WIDTH = max(len(shown) for shown, *_ in VERDICTS.values())


def result_text(result: CaseResult, width: int) -> str:
    """Return the result of a case in one line, with its reason and changes below."""
    # The summary of an error, such as a small angle, would look like that of a pass.
    summary = "" if result.verdict == "error" else result.summary
    if result.updated is not None and result.verdict != "error":
        planned = result.pin is None and result.updated != "kept"
        summary = f"{'would be ' if planned else ''}{result.updated:<7}  {summary}"
    name = f"{plain(result.name):<{width}}"
    first = f"{VERDICTS[result.verdict][0]:<{WIDTH}}  {name}  {summary or plain(result.reason)}"
    indent = " " * (WIDTH + 2)
    below = filter(None, [result.reason if summary else result.summary, *result.changes])
    return "\n".join([first.rstrip(), *(f"{indent}{plain(text)}" for text in below)])


def note_lines(results: Sequence[CaseResult], *, remarks: bool) -> Iterator[str]:
    """Yield each note once, with the number of its cases; a failure has them in its reason.

    `remarks`: whether to include all remarks on logs, even pinned ones
    """
    names: dict[str, list[str]] = {}
    for result in results:
        notes = () if result.verdict in {"fail", "error"} else result.notes
        for note in dict.fromkeys([*notes, *(result.remarks if remarks else ())]):
            names.setdefault(note, []).append(plain(result.name))
    for note, cases in names.items():
        yield f"note on {cases[0] if len(cases) == 1 else f'{len(cases)} cases'}: {plain(note)}"


def worst_first(results: Iterable[CaseResult]) -> list[CaseResult]:
    """Return results in the order of their urgency."""
    order: list[Verdict] = ["error", "fail", "xpass", "deleted", "xfail", "pass", "skip"]
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
    elements = [JUNIT_ELEMENTS.get(result.verdict) for result in results]
    counts = {
        "tests": str(len(results)),
        "failures": str(elements.count("failure")),
        "errors": str(elements.count("error")),
        "time": f"{sum(result.seconds for result in results):.3f}",
    }
    root = ET.Element("testsuites", counts)
    facts = {"name": plain(suite.name), "file": plain(suite.as_posix()), **counts}
    tests = ET.SubElement(root, "testsuite", {**facts, "skipped": str(elements.count("skipped"))})
    for result in results:
        facts = {"classname": plain(suite.stem), "name": plain(result.name)}
        case = ET.SubElement(tests, "testcase", {**facts, "time": f"{result.seconds:.3f}"})
        texts = [result.summary, result.reason, *result.changes, *result.notes]
        if result.verdict in JUNIT_ELEMENTS:
            reason = plain(result.reason)
            element = ET.SubElement(case, JUNIT_ELEMENTS[result.verdict], {"message": reason})
            place = f"{plain(suite.as_posix())}:{result.line}"
            element.text = "\n".join(filter(None, [place, result.summary, reason]))
        else:
            ET.SubElement(case, "system-out").text = "\n".join(map(plain, filter(None, texts)))
    ET.indent(root)
    with open_atomic(target) as stream:
        ET.ElementTree(root).write(stream, encoding="utf-8", xml_declaration=True)
        stream.write(b"\n")


def append_github_summary(target: str, suite: Path, results: Sequence[CaseResult]) -> None:
    """Append a table of results to the summary of a GitHub step."""
    text = f"### {_markdown(suite.as_posix())}: {totals(results)}\n\n"
    text += "| case | verdict | worst error | why |\n|---|---|---|---|\n"
    with output_errors(target), Path(target).open("a", encoding="utf-8") as stream:
        remaining = MAX_SUMMARY - stream.tell()
        for number, result in enumerate(worst_first(results)):
            why = result.reason or "; ".join([*result.changes, *result.notes])
            cells = [result.name, VERDICTS[result.verdict][2], result.summary, why]
            row = f"| {' | '.join(map(_markdown, cells))} |\n"
            remaining -= len(row.encode())
            if remaining < 0:
                more = count_text(len(results) - number, "more case")
                text += f"\n{more} for which there is no room here; see JUnit or the log\n"
                break
            text += row
        stream.write(f"{text}\n")


def github_annotations(suite: Path, results: Sequence[CaseResult]) -> Iterator[str]:
    """Yield annotations on the suite, for each case that needs attention, worst first."""
    kinds: dict[str, list[str]] = {"error": [], "warning": []}
    for result in worst_first(results):
        if result.verdict in NEEDS_ATTENTION or result.unpinned:
            kind = "error" if result.verdict in {"fail", "error"} else "warning"
            where = f"file={_property(suite.as_posix())},line={result.line}"
            title = _property(f"{result.name}: {result.verdict}")
            texts = [result.summary, result.reason or "; ".join(result.notes)]
            message = _message("; ".join(filter(None, texts)))
            kinds[kind].append(f"::{kind} {where},title={title}::{message}")
    for kind, lines in kinds.items():
        if len(lines) <= MAX_ANNOTATIONS:
            yield from lines
            continue
        yield from lines[: MAX_ANNOTATIONS - 1]
        more = f"{len(lines) - MAX_ANNOTATIONS + 1} more cases, {len(lines)} in all"
        yield f"::{kind} file={_property(suite.as_posix())},line=1::{more}"


def _markdown(text: str) -> str:
    """Escape text for a cell of a Markdown table."""
    text = plain(text)
    for mark in "\\`*_[]<>|":
        text = text.replace(mark, "\\" + mark)
    return text


def _message(text: str) -> str:
    return plain(text).replace("%", "%25")


def _property(text: str) -> str:
    return _message(text).replace(":", "%3A").replace(",", "%2C")
