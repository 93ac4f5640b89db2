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

    from quatprop.check.case import BrokenCase, Case, CaseResult
    from quatprop.check.suite import Suite


@click.command(no_args_is_help=True)
@click.argument("suite", metavar="SUITE.toml")
@click.option(
    "-k",
    "patterns",
    metavar="EXPR",
    multiple=True,
    help="Only cases whose names contain EXPR, or match it where it has *, ? or [...]; can be "
    "repeated.  [default: all]",
)
@click.option(
    "-j",
    "processes",
    type=click.IntRange(min=1),
    metavar="N",
    default=1,
    show_default=True,
    help="Cases at a time, each in a process of its own; the output is the same for any N.",
)
@click.option(
    "--update",
    is_flag=True,
    help="Write the references of cases that are new, changed or fail, and show what changed. "
    "Cases that pass are left as they are.",
)
@click.option(
    "--junit", metavar="FILE", help="Also write the results as JUnit XML.  [default: none]"
)
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout instead of text.")
@quiet_option
def command(suite: str, **options: Any) -> None:
    """Compare recorded logs with references.

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
    max-dt...; those of its B begin with reference-, as reference-topic); paths are relative to
    the suite. --update writes the references, and SUITE.lock.json, which pins the SHA-256 of the
    inputs and the options of each case. Keep all of them with the suite. Use pin-log = false
    where the system under test makes the log.

    Exit code 0: all pass; 1: a case failed; 2: there was an error (a log is missing, or something
    that is pinned changed), whatever the other cases do.
    """
    from quatprop.check.case import exit_code
    from quatprop.check.cases import load_cases
    from quatprop.check.lock import read_lock
    from quatprop.check.runner import run_cases, select_cases

    loaded, all_cases = load_cases(suite)
    patterns = options["patterns"]
    cases = select_cases(all_cases, patterns)
    if not cases:
        raise click.UsageError(f"no case of {suite} matches -k {' -k '.join(patterns)}")
    names = {case.name for case in all_cases}
    pins = {name: pin for name, pin in read_lock(loaded.lock).items() if name in names}
    _refuse_overlap(loaded, all_cases, options["junit"])
    lock = loaded.lock if options["update"] else None
    running = run_cases(cases, pins, lock=lock, processes=options["processes"])
    with closing(running):
        results = _show(running, cases, quiet=options["as_json"] or options["quiet"])
    if options["as_json"]:
        click.echo(json.dumps(_report(loaded, results), indent=2))
    _report_to_ci(loaded, results, options["junit"])
    if code := exit_code(results):
        raise click.exceptions.Exit(code)


def _refuse_overlap(suite: Suite, cases: Sequence[Case | BrokenCase], junit: str | None) -> None:
    """Refuse to replace an input of a case, or another output."""
    from quatprop.check.case import Case
    from quatprop.writers.targets import checked_place, refuse_overlap

    valid = [case for case in cases if isinstance(case, Case)]
    inputs = [path for case in valid for path in case.inputs.values()]
    references = [case.reference for case in valid]
    refuse_overlap([str(suite.path), *inputs], [str(suite.lock), *references, junit])
    if junit is not None:
        checked_place(junit)


def _show(
    running: Iterable[CaseResult], cases: Sequence[Case | BrokenCase], *, quiet: bool
) -> list[CaseResult]:
    """Show the result of each case as soon as it is there, and return all of them."""
    from quatprop.check.reports import result_text, totals
    from quatprop.text import plain

    width = max(len(plain(case.name)) for case in cases)
    results = []
    for result in running:
        results.append(result)
        if not quiet:
            click.echo(result_text(result, width))
    if not quiet:
        click.echo(totals(results))
    return results


def _report(suite: Suite, results: list[CaseResult]) -> Any:
    from quatprop import __version__
    from quatprop.provenance import as_json

    verdicts = [result.verdict for result in results]
    return as_json(
        {
            "quatprop": __version__,
            "suite": suite.path,
            "passed": verdicts.count("pass"),
            "failed": verdicts.count("fail"),
            "errors": verdicts.count("error"),
            "cases": [result.report() for result in results],
        }
    )


def _report_to_ci(suite: Suite, results: list[CaseResult], junit: str | None) -> None:
    """Write what CI services read."""
    from quatprop.check.reports import append_github_summary, github_annotations, write_junit

    if junit is not None:
        write_junit(junit, suite.path, results)
    if summary := os.environ.get("GITHUB_STEP_SUMMARY"):
        append_github_summary(summary, suite.path, results)
    if os.environ.get("GITHUB_ACTIONS") == "true":
        for annotation in github_annotations(suite.path, results):
            click.echo(annotation, err=True)
