"""Run cases, one after another or in processes, with results in the order of the suite."""

from __future__ import annotations

import math
import time
from contextlib import closing
from functools import partial
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote
from xml.etree import ElementTree as ET

from quatprop.base import __version__
from quatprop.base.errors import QuatpropError, as_user_error
from quatprop.base.processes import KILLED, in_order, map_processes
from quatprop.base.provenance import as_json
from quatprop.base.rendering import count_text
from quatprop.base.text import Setting, plain, spelled, spelling
from quatprop.settings import in_keys
from quatprop.tools.check.case import Case, CaseNotRun, CaseResult
from quatprop.tools.check.expect import unmet
from quatprop.tools.check.judge import Baseline, Judgement, install, judge, propose, refuse_target
from quatprop.tools.check.lock import Pin, merge_into_lock
from quatprop.writers.atomic import write_atomic
from quatprop.writers.targets import output_errors, refuse_outside

if TYPE_CHECKING:
    from collections.abc import (
        Callable,
        Collection,
        Generator,
        Iterable,
        Iterator,
        Mapping,
        Sequence,
    )

    from quatprop.tools.check.case import Verdict
    from quatprop.tools.check.cases import Suite

    PinnedCase = tuple[Case | CaseNotRun, Pin | None]


class CheckOptions(NamedTuple):
    """How cases are run.

    `suite`: the suite whose references and lock an update writes; None to judge only
    `orphans`: pins and stored references of no case in the suite
    `removed`: cases that the update removes from the lock
    `dry_run`: list the changes of an update without writing anything
    `force`: also accept changes that cannot be measured
    `confirm`: asks whether to accept a change; None to accept all
    `artifacts`: folder for the evidence of failures; None to keep none
    `strict`: deleted cases, unexpected passes and unpinned remarks are failures
    """

    suite: Suite | None = None
    orphans: Sequence[Baseline] = ()
    removed: Collection[str] = ()
    dry_run: bool = False
    force: bool = False
    confirm: Callable[[CaseResult], bool] | None = None
    artifacts: Path | None = None
    strict: bool = False


@spelling(in_keys)
def run_case(pinned: PinnedCase, options: CheckOptions) -> CaseResult:
    """Judge or update a case; an error becomes its result."""
    case, pin = pinned
    began = time.perf_counter()
    if isinstance(case, CaseNotRun):
        result = _strictly(CaseResult(case.name, case.verdict, case.reason), options)
    else:
        try:
            with TemporaryDirectory(prefix="quatprop-") as scratch:
                result = _run(case, pin, options, Path(scratch))
        except Exception as error:
            if (user_error := as_user_error(error)) is None:
                raise
            result = CaseResult(case.name, "error", str(user_error))
    return result._replace(seconds=time.perf_counter() - began, line=case.line)


def _run(case: Case, pin: Pin | None, options: CheckOptions, scratch: Path) -> CaseResult:
    if case.is_gate:
        return _strictly(
            _apply_xfail(case, _expected(case, CaseResult(case.name, "pass"))), options
        )
    # An update would make a known failure pass.
    suite = None if case.xfail and pin else options.suite
    if suite is not None:
        refuse_target(case, pin, suite.lock.parent)
    judged = judge(case, pin, scratch)
    if suite is not None:
        judged = judged._replace(result=_updated(case, pin, judged, options, scratch))
    else:
        judged = judged._replace(result=_expected(case, judged.result))
    result = _apply_xfail(case, judged.result)
    if result.verdict == "error" and options.suite is not suite:
        reason = spelled(f"{result.reason}; {Setting('update')} leaves it as it is, because of")
        result = result._replace(
            reason=f"{reason} xfail, so that no failure is pinned: take it out"
        )
    result = _strictly(result, options)
    if options.artifacts is not None and result.verdict in {"fail", "error", "xfail"}:
        return _with_evidence(case, judged._replace(result=result), options)
    return result


def _expected(case: Case, result: CaseResult) -> CaseResult:
    """Return the result of a case, failed if its log is not as expected."""
    if case.expect is None:
        return result
    reasons = [*unmet(case.logs, case.propagation, case.expect)]
    if not reasons:
        return result._replace(summary=result.summary or "the log is as expected")
    verdict: Verdict = "fail" if result.verdict == "pass" else result.verdict
    return result._replace(
        verdict=verdict, reason="; ".join(filter(None, [result.reason, *reasons]))
    )


def _updated(
    case: Case, pin: Pin | None, judged: Judgement, options: CheckOptions, scratch: Path
) -> CaseResult:
    """Update a case, unless the change is not accepted."""
    proposal = propose(case, pin, judged, scratch, options.orphans)
    if proposal.unmeasured and not options.force:
        return CaseResult(case.name, "error", proposal.unmeasured, changes=proposal.result.changes)
    if options.dry_run:
        return proposal.result._replace(pin=None)
    is_change = proposal.result.updated != "kept" or proposal.result.changes
    if is_change and options.confirm is not None and not options.confirm(proposal.result):
        return judged.result
    install(case, proposal)
    return proposal.result


def _apply_xfail(case: Case, result: CaseResult) -> CaseResult:
    """Return the result of a case, allowing for a known failure."""
    if case.xfail and result.verdict == "fail":
        return result._replace(verdict="xfail", reason=f"{case.xfail}: {result.reason}")
    if case.xfail and result.verdict == "pass":
        return result._replace(verdict="xpass", reason=f"it is known to fail: {case.xfail}")
    return result


def _strictly(result: CaseResult, options: CheckOptions) -> CaseResult:
    """Return a result; under ``--strict``, one that needs attention is a failure."""
    if not options.strict:
        return result
    strict = spelled(f"with {Setting('strict')} this is a failure")
    if result.verdict in {"xpass", "deleted"}:
        return result._replace(verdict="fail", reason=f"{result.reason}; {strict}")
    if result.verdict == "pass" and result.unpinned:
        reasons = [f"not pinned: {note}" for note in result.notes]
        return result._replace(verdict="fail", reason="; ".join([*reasons, strict]))
    return result


def _with_evidence(case: Case, judged: Judgement, options: CheckOptions) -> CaseResult:
    """Keep the evidence of a failure, and add its folder, or why it is missing, to the reason."""
    from quatprop.tools.check.artifacts import write_artifacts  # matplotlib, for failures only

    result, folder = judged.result, Path(str(options.artifacts))
    try:
        with output_errors(folder):
            place = str(write_artifacts(case, judged, folder, strict=options.strict))
        return result._replace(reason=f"{result.reason}; see {plain(place)}", evidence=place)
    except QuatpropError as error:
        return result._replace(reason=f"{result.reason}; its artifacts cannot be kept: {error}")


def run_cases(
    cases: Sequence[Case | CaseNotRun],
    pins: Mapping[str, Pin],
    options: CheckOptions,
    processes: int,
) -> Generator[CaseResult]:
    """Yield the result of each case in the order of the suite, as soon as possible.

    An update writes the lock at the end, without the removed cases.
    """
    new_pins: dict[str, Pin] = {}

    def record(result: CaseResult) -> None:
        if result.pin is not None:
            new_pins[result.name] = result.pin

    pinned = [(case, pins.get(case.name)) for case in cases]
    results = map_processes(
        partial(run_case, options=options), pinned, processes, _killed, record=record
    )
    try:
        with closing(results):
            yield from in_order(results)
    finally:
        if (suite := options.suite) is not None and not options.dry_run:
            # After an interruption, too: the lock must have the references that were written.
            merge_into_lock(suite.path, suite.lock, new_pins, options.removed)


def _killed(pinned: PinnedCase) -> CaseResult:
    case, _ = pinned
    return CaseResult(case.name, "error", KILLED, line=case.line)


# Results of cases as text, as JUnit XML, and as GitHub annotations and summaries.
#
# Reference: "Workflow commands for GitHub Actions", docs.github.com: ``::error
# file=,line=,title=::message``, of which ten of a kind are shown for a step, and Markdown appended
# to the file that ``GITHUB_STEP_SUMMARY`` names, 1 MiB at most.
#
# junit-10.xsd of the xUnit plugin of Jenkins, which pytest also conforms to: cases have no line and
# no file, and the root element has no count of skipped cases.


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


def report_of(suite: Suite, results: Sequence[CaseResult], *, passed: bool) -> Any:
    """Return the results, ready for JSON."""
    verdicts = [result.verdict for result in results]
    return as_json(
        {
            "quatprop": __version__,
            "suite": suite.path,
            "passed": passed,
            "counts": {verdict: verdicts.count(verdict) for verdict in VERDICTS},
            "cases": [result.report() for result in results],
        }
    )


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
    write_atomic(target, ET.tostring(root, "utf-8", xml_declaration=True) + b"\n")


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


# Overview of a suite: an HTML file with a row and a small plot for each case.


STYLE = """\
table { margin-top: 1rem }
th { width: auto; white-space: nowrap } td:nth-child(2), td:nth-child(3) { white-space: nowrap }
button { all: unset; cursor: pointer; font-weight: bold }
button:focus-visible { outline: 2px solid }
.fail, .error { color: #d33 } .xpass, .deleted { color: #b70 }
svg { width: 160px; height: 32px; stroke: currentcolor; fill: none }
@media (max-width: 36rem) { thead { display: none } tr, td { display: block }
  tr { border-bottom: 1px solid var(--edge); padding: .4rem 0 } td { border: 0; padding: .1rem 0 } }
"""

SCRIPT = """\
for (const button of document.querySelectorAll('th button')) button.onclick = () => {
  const head = button.parentElement, column = head.cellIndex;
  const body = document.querySelector('tbody'), up = head.ariaSort !== 'ascending';
  for (const other of head.parentElement.cells) other.ariaSort = null;
  head.ariaSort = up ? 'ascending' : 'descending';
  const key = row => row.cells[column].dataset.key;
  body.append(...[...body.rows].sort((a, b) => (up ? 1 : -1)
    * key(a).localeCompare(key(b), 'en', {numeric: true})));
};
"""

HEADS = ("case", "verdict", "worst error", "over time", "why")


def write_overview(folder: Path, suite: Path, results: Sequence[CaseResult]) -> None:
    """Write ``index.html``: each case, worst first, with a link to its page."""
    target = folder / "index.html"
    refuse_outside(target, folder)
    folder.mkdir(parents=True, exist_ok=True)
    from quatprop.tools.plot.page import document

    title = escape(plain(suite.as_posix()))
    heads = "".join(f'<th scope="col"><button>{head}</button></th>' for head in HEADS)
    body = [
        f"<h1>{title}</h1><p>{escape(totals(results))}</p>",
        f"<table><thead><tr>{heads}</tr></thead><tbody>",
        *(_row(result, order, folder) for order, result in enumerate(worst_first(results))),
        "</tbody></table>",
    ]
    write_atomic(target, document(suite.as_posix(), body, script=SCRIPT, style=STYLE))


def _row(result: CaseResult, order: int, folder: Path) -> str:
    name = escape(plain(result.name))
    if result.evidence is not None:
        page = quote(Path(result.evidence, "error.html").relative_to(folder).as_posix())
        name = f'<a href="{page}">{name}</a>'
    error = result.error_rad
    size = "" if error is None else f"{math.degrees(error):.6g} deg"
    why = result.reason or "; ".join([*result.changes, *result.notes])
    cells = [
        (plain(result.name), name),
        (str(order), f'<span class="{result.verdict}">{VERDICTS[result.verdict][0]}</span>'),
        (f"{(error or 0.0) * 1e15:.0f}", size),
        (f"{(error or 0.0) * 1e15:.0f}", _plot(result)),
        (why, "<br>".join(escape(plain(text)) for text in (result.summary, why) if text)),
    ]
    inside = "".join(f'<td data-key="{escape(plain(key))}">{text}</td>' for key, text in cells)
    return f"<tr>{inside}</tr>"


def _plot(result: CaseResult) -> str:
    """Return a line plot of the error over time, scaled from 0 to its maximum."""
    largest = max(result.trace, default=0.0)
    if largest <= 0.0:
        return ""
    last = max(len(result.trace) - 1, 1)
    points = " ".join(
        f"{158 * k / last + 1:.1f},{31 - 30 * error / largest:.1f}"
        for k, error in enumerate(result.trace)
    )
    label = f"error over time, at most {math.degrees(largest):.4g} deg"
    return f'<svg role="img" aria-label="{label}"><polyline points="{points}"/></svg>'
