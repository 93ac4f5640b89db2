"""``quatprop check``: regression of recorded logs against references."""

from __future__ import annotations

import json
import os
from contextlib import closing
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.options import quiet_option

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from quatprop.check.case import BrokenCase, Case, Outcome
    from quatprop.check.suite import Suite


@click.command(no_args_is_help=True)
@click.argument("suite", metavar="SUITE.toml")
@click.option(
    "-k",
    "patterns",
    metavar="EXPR",
    multiple=True,
    help="Only cases whose names hold EXPR, or match it where it has *, ? or [...]; can be "
    "repeated.  [default: all]",
)
@click.option(
    "-j",
    "processes",
    type=click.IntRange(min=1),
    metavar="N",
    default=1,
    show_default=True,
    help="Cases at a time, each in a process of its own; what is said is the same for any N.",
)
@click.option(
    "--update",
    is_flag=True,
    help="Make references of what is new, changed or fails, and show what changed. What passes "
    "is left as it is.",
)
@click.option(
    "--junit", metavar="FILE", help="Write the outcomes as JUnit XML, too.  [default: none]"
)
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout instead of text.")
@quiet_option
def command(suite: str, **asked: Any) -> None:
    """Hold recorded logs against references.

    SUITE.toml has one table [case.NAME] for each case, and [defaults] for all of them:

    \b
      [defaults]
      tol = "1e-9rad"
      [case.flight]
      log = "logs/flight.bag"
      method = "coning"
      reference = "refs/flight.parquet"
      [case.capture]
      log = "logs/flight.bag"
      reference-topic = "/vicon/body"
      align = "mount"
      tol = "3deg"

    Keys are the options of propagate (topic, method, bias...) and of compare (tol, align,
    max-dt...; of its B as reference-topic, reference-log, reference-from-layout...); paths are
    relative to the suite. --update writes the references, and SUITE.lock.json, which pins what
    every case rests on: the SHA-256 of its inputs and its options. Keep all of them with the
    suite. Say pin-log = false where what is tested makes the log anew.

    Exit code 0: all pass; 2: a case could not be judged (its log is missing, or something that it
    rests on changed), whatever the others do; 1: a case failed.
    """
    from quatprop.check.case import exit_code
    from quatprop.check.lock import read_lock
    from quatprop.check.runner import chosen, outcomes, updates
    from quatprop.cli.cases import load_cases

    written, every = load_cases(suite)
    patterns = asked["patterns"]
    cases = chosen(every, patterns)
    if not cases:
        raise click.UsageError(f"no case of {suite} matches -k {' -k '.join(patterns)}")
    names = {case.name for case in every}
    pins = {name: pin for name, pin in read_lock(written.lock).items() if name in names}
    _refuse_overlap(written, every, asked["junit"])
    processes = asked["processes"]
    found = (
        updates(cases, pins, written.lock, processes=processes)
        if asked["update"]
        else outcomes(cases, pins, processes=processes)
    )
    with closing(found):
        done = _said(found, cases, speaks=not (asked["as_json"] or asked["quiet"]))
    if asked["as_json"]:
        click.echo(json.dumps(_report(written, done), indent=2))
    _report_elsewhere(written, done, asked["junit"])
    if code := exit_code(done):
        raise click.exceptions.Exit(code)


def _refuse_overlap(suite: Suite, cases: Sequence[Case | BrokenCase], junit: str | None) -> None:
    """Refuse to write over what a case reads, or over another output."""
    from quatprop.check.case import Case
    from quatprop.writers.atomic import checked_place
    from quatprop.writers.overlap import refuse_overlap

    known = [case for case in cases if isinstance(case, Case)]
    inputs = [path for case in known for path in case.inputs.values()]
    references = [case.reference for case in known]
    refuse_overlap([str(suite.path), *inputs], [str(suite.lock), *references, junit])
    if junit is not None:
        checked_place(junit)


def _said(
    found: Iterable[Outcome], cases: Sequence[Case | BrokenCase], *, speaks: bool
) -> list[Outcome]:
    """Say what comes of each case as soon as it is known."""
    from quatprop.check.summary import line, tally
    from quatprop.text import plain

    width = max(len(plain(case.name)) for case in cases)
    done: list[Outcome] = []
    for outcome in found:
        done.append(outcome)
        if speaks:
            click.echo(line(outcome, width))
    if speaks:
        click.echo(tally(done))
    return done


def _report(suite: Suite, done: list[Outcome]) -> dict[str, object]:
    from quatprop import __version__

    verdicts = [outcome.verdict for outcome in done]
    return {
        "quatprop": __version__,
        "suite": str(suite.path),
        "passed": verdicts.count("pass"),
        "failed": verdicts.count("fail"),
        "errors": verdicts.count("error"),
        "cases": [outcome.report() for outcome in done],
    }


def _report_elsewhere(suite: Suite, done: list[Outcome], junit: str | None) -> None:
    """Tell CI what it understands."""
    from quatprop.check.github import annotated, append_summary
    from quatprop.check.junit import write_junit

    if junit is not None:
        write_junit(junit, suite.path, done)
    if summary := os.environ.get("GITHUB_STEP_SUMMARY"):
        append_summary(summary, suite.path, done)
    if os.environ.get("GITHUB_ACTIONS") == "true":
        for words in annotated(suite.path, done):
            click.echo(words, err=True)
