"""Outcomes as GitHub shows them: a summary of the step, and annotations of the suite.

References
----------
"Workflow commands for GitHub Actions", docs.github.com: ``::error file=,line=,title=::message``,
and Markdown appended to the file that ``GITHUB_STEP_SUMMARY`` names.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.check.summary import tally
from quatprop.errors import OutputError
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.check.case import Outcome

VERDICTS = {"pass": "passed", "fail": ":x: failed", "error": ":warning: error"}
"""What the table says of a verdict."""


def append_summary(target: str, suite: Path, outcomes: Sequence[Outcome]) -> None:
    """Append a table of outcomes to the summary of a step.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    rows = [f"### {_cell(suite.as_posix())}: {tally(outcomes)}", ""]
    rows += ["| case | verdict | worst error | why |", "|---|---|---|---|"]
    for outcome in outcomes:
        why = outcome.reason or "; ".join([*outcome.changes, *outcome.notes])
        cells = [outcome.name, VERDICTS[outcome.verdict], outcome.figure, why]
        rows.append(f"| {' | '.join(map(_cell, cells))} |")
    try:
        with Path(target).open("a", encoding="utf-8") as stream:
            stream.write("\n".join(rows) + "\n\n")
    except OSError as error:
        raise OutputError(target, f"cannot be written: {error.strerror or error}") from error


def annotated(suite: Path, outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Yield a line for each case that did not pass, which GitHub shows beside the suite."""
    for outcome in outcomes:
        if outcome.verdict != "pass":
            where = f"file={_property(suite.as_posix())},line={outcome.line}"
            title = _property(f"{outcome.name}: {outcome.verdict}")
            words = "; ".join(filter(None, [outcome.figure, outcome.reason]))
            yield f"::error {where},title={title}::{_data(words)}"


def _cell(text: str) -> str:
    """Return text that a cell of a Markdown table shows as it is."""
    text = plain(text)
    for mark in "\\`*_[]<>|":
        text = text.replace(mark, "\\" + mark)
    return text


def _data(text: str) -> str:
    return plain(text).replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
