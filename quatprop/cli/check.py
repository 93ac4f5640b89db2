"""``quatprop check``: regression of recorded logs against references."""

from __future__ import annotations

import json
import os
from contextlib import closing, contextmanager, nullcontext
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.help import Command
from quatprop.cli.options import JSON, with_options
from quatprop.cli.types import PATH
from quatprop.settings.keyword import Keyword
from quatprop.settings.parsers import flag
from quatprop.text import listed, plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from quatprop.check.case import Case, CaseNotRun, CaseResult
    from quatprop.check.lock import Pin
    from quatprop.check.suite import Suite


MAX_LISTED = 8
"""Of more cases, those that pass are only counted."""


EXAMPLES = (
    "quatprop check suite.toml --init sample_logs/spin.csv sample_logs/tumbling.bag",
    "quatprop check suite.toml",
)


OPTIONS = {
    "-j processes": Keyword(click.IntRange(min=1),
        "Cases at a time, each in a process of its own; the output is the same for any N.", "1",
        "N", preset=True),
    "--update": Keyword(
        flag, "Write the references of cases that are new, changed or fail, and show what "
        "changed. Cases that pass are left as they are."),
    "--init": Keyword(flag, "Write SUITE.toml, with a case for each LOG, and the references."),
    "--explain": Keyword(
        flag, "Show what the cases depend on, what is pinned, and how they are judged; run "
        "nothing."),
    "--artifacts": Keyword(
        PATH, "Keep the attitudes, a page with the error, and the commands of each case that "
        "fails in DIR/CASE.", takes="DIR"),
    "--strict": Keyword(
        flag, "Fail, too, if a case that is pinned is no longer in the suite, or if one passes "
        "that is known to fail."),
    "--junit": Keyword(PATH, "Also write the results as JUnit XML.", takes="FILE"),
    **JSON,
    "-q --quiet": Keyword(flag, "Only failures and the totals."),
    "-v --verbose": Keyword(flag, "A line for every case that passes, and remarks on the logs."),
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, grouped=False, no_args_is_help=True)
@click.argument("suite", type=PATH, metavar="SUITE.toml")
@click.argument("logs", type=PATH, metavar="[LOG...]", nargs=-1)
@click.option(
    "-k",
    "patterns",
    metavar="EXPR",
    multiple=True,
    help="Only cases whose names contain EXPR, or match it where it has *, ? or [...]; can be "
    "repeated.  [default: all]",
)
@with_options(OPTIONS)
def command(suite: str, logs: tuple[str, ...], **options: Any) -> int:
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
      reference-log = "refs/vicon.csv"
      align = "mount"
      tol = "3deg"

    Keys are the options of propagate (topic, method, bias...) and of compare (tol, align,
    max-dt...; those of its B begin with reference-, as reference-topic); paths are relative to
    the suite. --update writes the references, and SUITE.lock.json, which pins the SHA-256 of the
    inputs and the options of each case. Keep all of them with the suite. Use pin-log = false
    where the system under test makes the log, skip = "REASON" to leave a case out, and
    xfail = "REASON" for a case that is known to fail.

    Exit code 0: all pass; 1: a case failed; 2: there was an error (a log is missing, or something
    that is pinned changed), whatever the other cases do.
    """
    from quatprop.check.case import exit_code
    from quatprop.check.cases import load_cases
    from quatprop.check.judge import explain
    from quatprop.check.lock import read_lock
    from quatprop.writers.targets import refuse_outside

    if options["init"] != bool(logs):
        raise click.UsageError("--init needs a LOG for each case, and nothing else takes one")
    with _new_suite(suite, logs) if options["init"] else nullcontext():
        loaded, all_cases = load_cases(suite)
        cases = _selected(all_cases, options["patterns"], suite)
        locked = read_lock(loaded.lock)
        pins = {case.name: locked[case.name] for case in all_cases if case.name in locked}
        deleted = {name: pin for name, pin in locked.items() if name not in pins}
        if options["explain"]:
            click.echo("\n\n".join(explain(case, pins.get(case.name)) for case in cases))
            return 0
        _refuse_overlap(loaded, all_cases, options["junit"])
        lock = loaded.lock if options["update"] or options["init"] else None
        if lock is not None:
            refuse_outside(lock, lock.parent)
        results = _run(cases, pins, lock, options)
    if options["init"] and not options["as_json"]:
        _report_new(loaded, results)
    missing = options["strict"] and deleted and lock is None
    code = exit_code(results, strict=options["strict"]) or int(bool(missing))
    if options["as_json"]:
        report = _report(loaded, results, deleted, passed=not code)
        click.echo(json.dumps(report, indent=2))
    _report_to_ci(loaded, results, options["junit"])
    if deleted:
        _report_deleted(all_cases, deleted, updating=lock is not None)
    return code


def _selected(
    cases: Sequence[Case | CaseNotRun], patterns: Sequence[str], suite: str
) -> Sequence[Case | CaseNotRun]:
    """Return the cases whose names contain a pattern or match it; all where there are none."""

    def matches(name: str, pattern: str) -> bool:
        return fnmatchcase(name, pattern) if set(pattern) & set("*?[") else pattern in name

    found = [case for case in cases if any(matches(case.name, one) for one in patterns or [""])]
    if not found:
        raise click.UsageError(f"no case of {suite} matches -k {' -k '.join(patterns)}")
    return found


@contextmanager
def _new_suite(path: str, logs: Iterable[str]) -> Iterator[None]:
    """Write a new suite, and remove it again, with its lock, if no case gets a reference."""
    from quatprop.check.lock import read_lock
    from quatprop.check.suite import write_suite

    write_suite(path, logs)
    try:
        yield
    finally:
        lock = Path(path).with_suffix(".lock.json")
        if not read_lock(lock):
            Path(path).unlink()
            lock.unlink(missing_ok=True)


def _report_new(suite: Suite, results: Sequence[CaseResult]) -> None:
    """Say what of a new suite was written."""
    written = sum(result.pin is not None for result in results)
    if not written:
        click.echo("wrote nothing, as no log could be propagated", err=True)
        return
    of = "" if written == len(results) else f" of {written} of {len(results)} cases"
    click.echo(f"wrote {suite.path}, {suite.lock} and the references{of}", err=True)


def _run(
    cases: Sequence[Case | CaseNotRun], pins: Mapping[str, Pin], lock: Path | None, options: Any
) -> list[CaseResult]:
    """Run cases, show their results, failures last, and return them."""
    from quatprop.check.reports import NEEDS_ATTENTION, note_lines, result_text, totals
    from quatprop.check.runner import run_cases

    listed = options["verbose"] or (len(cases) <= MAX_LISTED and not options["quiet"])
    artifacts = options["artifacts"] and Path(options["artifacts"])
    running = run_cases(cases, pins, lock=lock, artifacts=artifacts, processes=options["processes"])
    width = max(len(plain(case.name)) for case in cases)
    results, last = [], []
    with closing(running):
        try:
            for result in running:
                results.append(result)
                if result.verdict in NEEDS_ATTENTION:
                    last.append(result)
                elif listed and not options["as_json"]:
                    click.echo(result_text(result, width))
        finally:
            # After an interruption, too.
            if not options["as_json"]:
                click.echo("".join(result_text(result, width) + "\n" for result in last), nl=False)
    if not options["as_json"]:
        notes = note_lines(results, remarks=options["verbose"])
        click.echo("\n".join([*notes, totals(results)]))
    return results


def _report_deleted(
    cases: Sequence[Case | CaseNotRun], deleted: Mapping[str, Pin], *, updating: bool
) -> None:
    """Name the cases that the lock has and the suite has not."""
    from quatprop.check.reference import orphaned_references

    if not updating:
        way_out = "restore them, or remove them from the lock with --update"
        click.echo(f"pinned, but not in the suite: {listed(deleted)}; {way_out}", err=True)
        return
    click.echo(f"removed from the lock: {listed(deleted)}", err=True)
    for path in orphaned_references(cases, deleted.values()):
        click.echo(f"no longer used, to be removed: {plain(path)}", err=True)


def _refuse_overlap(suite: Suite, cases: Sequence[Case | CaseNotRun], junit: str | None) -> None:
    """Refuse to replace an input of a case, or another output."""
    from quatprop.check.case import Case
    from quatprop.writers.targets import checked_place, refuse_overlap

    valid = [case for case in cases if isinstance(case, Case)]
    inputs = [path for case in valid for path in case.inputs.values()]
    references = [case.reference for case in valid]
    refuse_overlap([str(suite.path), *inputs], [str(suite.lock), *references, junit])
    if junit is not None:
        checked_place(junit)


def _report(
    suite: Suite, results: list[CaseResult], deleted: Mapping[str, Pin], *, passed: bool
) -> Any:
    from quatprop.check.reports import VERDICTS
    from quatprop.provenance import as_json
    from quatprop.version import __version__

    verdicts = [result.verdict for result in results]
    return as_json(
        {
            "quatprop": __version__,
            "suite": suite.path,
            "passed": passed,
            "counts": {verdict: verdicts.count(verdict) for verdict in VERDICTS},
            "deleted": list(deleted),
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
