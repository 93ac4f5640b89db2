"""Outcomes in words: a line a case, what is to be said of it beneath."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.check.case import Outcome

VERDICTS = {"pass": "pass", "fail": "FAIL", "error": "ERROR"}
"""What a line begins with."""

WIDTH = max(map(len, VERDICTS.values()))


def line(outcome: Outcome, width: int) -> str:
    """Return what came of a case in lines.

    Parameters
    ----------
    outcome
        What came of it.
    width
        Of the column of names.
    """
    figure = outcome.figure
    if outcome.updated is not None and outcome.verdict != "error":
        figure = f"{outcome.updated:<7}  {figure}"
    words = figure or plain(outcome.reason)
    first = f"{VERDICTS[outcome.verdict]:<{WIDTH}}  {plain(outcome.name):<{width}}  {words}"
    beneath = [outcome.reason] if figure and outcome.reason else []
    beneath += [*outcome.changes, *(() if outcome.reason else outcome.notes)]
    indent = " " * (WIDTH + 2)
    return "\n".join([first.rstrip(), *(f"{indent}{plain(words)}" for words in beneath)])


def tally(outcomes: Sequence[Outcome]) -> str:
    """Return how many passed, failed, and could not be judged.

    Examples
    --------
    >>> from quatprop.check.case import Outcome
    >>> tally([Outcome("a", "pass"), Outcome("b", "fail"), Outcome("c", "pass")])
    '3 cases: 2 passed, 1 failed'
    """
    counts = dict.fromkeys(VERDICTS, 0)
    for outcome in outcomes:
        counts[outcome.verdict] += 1
    said = [f"{counts['pass']} passed"]
    said += [f"{counts['fail']} failed"] if counts["fail"] else []
    said += [f"{counts['error']} could not be judged"] if counts["error"] else []
    return f"{len(outcomes)} case{'s' * (len(outcomes) != 1)}: {', '.join(said)}"
