"""Run the cases of a suite, and show their results in the terminal and to CI services."""

from __future__ import annotations

import os
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quatprop.errors import QuatpropError
from quatprop.rendering import count_text
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from quatprop.check.case import Case, CaseNotRun, CaseResult
    from quatprop.check.lock import Pin
    from quatprop.check.suite import Suite
    from quatprop.check.update import Baseline


MAX_LISTED = 8
"""Maximum number of cases for which those that pass are listed."""


def run_and_show(
    suite: Suite,
    cases: Sequence[Case | CaseNotRun],
    pins: Mapping[str, Pin],
    not_in_suite: tuple[Sequence[Baseline], Mapping[str, Pin]],
    options: Any,
) -> list[CaseResult]:
    """Run cases, show their results, failures last, and return them.

    `not_in_suite`: orphaned references, and the pins that an update removes
    """
    from quatprop.check.case import CaseResult
    from quatprop.check.reports import note_lines, totals
    from quatprop.check.runner import CheckOptions, run_cases

    updating = options["update"] or options["init"]
    width = max((len(plain(case.name)) for case in cases), default=0)
    run_options = CheckOptions(
        suite=suite if updating else None,
        orphans=not_in_suite[0],
        removed=not_in_suite[1],
        dry_run=options["dry_run"],
        force=options["force"],
        confirm=partial(_confirmed, width) if options["interactive"] else None,
        artifacts=options["artifacts"] and Path(options["artifacts"]),
        strict=options["strict"],
    )
    running = run_cases(cases, pins, run_options, options["processes"])
    results: list[CaseResult] = []
    try:
        with closing(running):
            few = len(cases) <= MAX_LISTED and not options["quiet"]
            _show(running, results, width, options, every=options["verbose"] or few)
    finally:
        # Also after an interruption: cases that were not run have not passed.
        reason = "the run was interrupted before this case was done"
        undone = [
            CaseResult(case.name, "error", reason, line=case.line) for case in cases[len(results) :]
        ]
        _report_to_ci(suite.path, [*results, *undone], options)
    if not options["as_json"]:
        click.echo("\n".join([*note_lines(results, remarks=options["verbose"]), totals(results)]))
    return results


def _show(
    running: Iterable[CaseResult],
    results: list[CaseResult],
    width: int,
    options: Any,
    *,
    every: bool,
) -> None:
    """Show results and append them to a list; those that need attention are shown last."""
    from quatprop.check.reports import NEEDS_ATTENTION, result_text

    last: list[str] = []
    try:
        for result in running:
            results.append(result)
            text = result_text(result, width) + "\n"
            if result.verdict in NEEDS_ATTENTION:
                last.append(text)
            elif not options["as_json"] and (
                every or result.changes or result.updated in {"new", "updated"}
            ):
                click.echo(text, nl=False)
    finally:
        # Also after an interruption.
        if not options["as_json"]:
            click.echo("".join(last), nl=False)


def _confirmed(width: int, result: CaseResult) -> bool:
    """Show a change and ask whether to accept it; the end of input means no."""
    from quatprop.check.reports import result_text

    click.echo(result_text(result, width), err=True)
    try:
        return click.confirm("accept?", err=True)
    except click.Abort:
        click.echo(err=True)
        return False


def report_deleted(
    suite: Suite,
    cases: Sequence[Case | CaseNotRun],
    deleted: Mapping[str, Pin],
    *,
    written: bool,
) -> None:
    """List the cases that an update removes from the lock, and their references."""
    from quatprop.check.reference import orphaned_references

    done = "removed" if written else "would be removed"
    for name, pin in deleted.items():
        final = ", ".join(f"{angle} {size:g}" for angle, size in pin.final_deg.items())
        pinned = f"{count_text(pin.samples, 'sample')}, total angle {pin.total_angle_deg:g} deg"
        click.echo(
            f"{done} from the lock: {quoted(name)}, pinned with {pinned}, final {final} deg",
            err=True,
        )
    if not written:
        click.echo("nothing was written, because of --dry-run", err=True)
        return
    for path in orphaned_references(suite.path.parent, cases, deleted.values()):
        click.echo(f"no longer used, to be removed: {plain(path)}", err=True)


def report_new(suite: Suite, results: Sequence[CaseResult]) -> None:
    """Report what was written for a new suite."""
    written = sum(result.pin is not None for result in results)
    if not written:
        click.echo("wrote nothing, as no log could be propagated", err=True)
        return
    of = "" if written == len(results) else f" of {written} of {len(results)} cases"
    click.echo(f"wrote {suite.path}, {suite.lock} and the references{of}", err=True)


def json_report(suite: Suite, results: list[CaseResult], *, passed: bool) -> Any:
    """Return the results, ready for JSON."""
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
            "cases": [result.report() for result in results],
        }
    )


@contextmanager
def errors_reported_to_ci(suite: Path, options: Mapping[str, Any]) -> Iterator[None]:
    """Also report an error that ends the run to CI, where reports of an earlier run may remain."""
    from quatprop.check.case import CaseResult

    try:
        yield
    except Exception as error:
        reason = error.format_message() if isinstance(error, click.ClickException) else str(error)
        junit = options["junit"]
        if junit is not None and not _may_be_junit(junit):
            junit = None
        # Errors of the report must not replace the error that ended the run.
        with suppress(Exception):
            result = CaseResult(suite.name, "error", reason)
            _report_to_ci(suite, [result], {**options, "junit": junit})
        raise


def _may_be_junit(path: str) -> bool:
    """Return whether a file has results or does not exist; the error may be that it is an input."""
    with suppress(OSError), Path(path).open("rb") as stream:
        return b"<testsuites" in stream.read(200)
    return path.endswith(".xml")


def _report_to_ci(suite: Path, results: list[CaseResult], options: Mapping[str, Any]) -> None:
    """Write the reports for CI services, and the overview of all cases."""
    from quatprop.check.reports import append_github_summary, github_annotations, write_junit

    if options["junit"] is not None:
        write_junit(options["junit"], suite, results)
    if summary := os.environ.get("GITHUB_STEP_SUMMARY"):
        append_github_summary(summary, suite, results)
    if os.environ.get("GITHUB_ACTIONS") == "true":
        for annotation in github_annotations(suite, results):
            click.echo(annotation, err=True)
    if options["artifacts"] is not None:
        from quatprop.check.overview import write_overview

        try:
            write_overview(Path(options["artifacts"]), suite, results)
        except (OSError, QuatpropError) as error:
            click.echo(f"the overview cannot be written: {error}", err=True)
