"""``quatprop check``: regression tests of recorded logs against references."""

from __future__ import annotations

import json
import os
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quatprop.base.errors import QuatpropError
from quatprop.base.text import plain
from quatprop.cli.commands import Command
from quatprop.cli.options import JSON, PATH, input_of, with_options
from quatprop.settings.parsers import Keyword, flag
from quatprop.settings.reading import CHECKS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from quatprop.tools.check.case import CaseResult
    from quatprop.tools.check.cases import Suite
    from quatprop.tools.check.selection import Selection


EXAMPLES = (
    "quatprop simulate demo.bag --motion tumbling",
    "quatprop simulate spin.csv",
    "quatprop check suite.toml --init demo.bag spin.csv",
    "quatprop check suite.toml",
)


OPTIONS = {
    "-j processes": Keyword(click.IntRange(min=1),
        "Number of cases at the same time, each in its own process; the output is the same "
        "for any N.", "1",
        "N", preset=True),
    "--update": Keyword(
        flag, "Write the references of cases that are new, changed or fail, and list each with "
        "what changes, in degrees. Cases that pass are left as they are."),
    "--dry-run": Keyword(flag, "With --update: list what would change, and write nothing."),
    "--interactive": Keyword(flag, "With --update: ask before each change."),
    "--force": Keyword(flag, "With --update or --init: also on a CI service (CI or another of "
        "its variables is set, and not to 0 or false), so that nobody reviews it; if the change of "
        "the attitudes cannot be measured; and if cases are removed from the lock."),
    "--init": Keyword(flag, "Write SUITE.toml, with a case for each LOG, and the references."),
    "--reference-log": Keyword(
        PATH,
        "With --init: also compare each LOG with these attitudes; limits are proposed from the "
        "measured errors. FILE:TOPIC names a topic.", takes="FILE"),
    "--topic-b": Keyword(
        click.STRING, "With --reference-log: its topic, if there are several.", takes="NAME"),
    "--on-invalid": Keyword(
        CHECKS["on_invalid"].parse, "With --reference-log: drop its invalid rows.",
        CHECKS["on_invalid"].default, "error|drop"),
    "--explain": Keyword(
        flag, "Show what the cases depend on, what is pinned, and how they are judged; run "
        "nothing. Exit code 2 if a file is missing."),
    "--artifacts": Keyword(
        PATH, "Keep the attitudes, a page with the error, and the commands of each case that "
        "fails in DIR/CASE, and an overview of all cases in DIR/index.html.", takes="DIR"),
    "--strict": Keyword(
        flag,
        "Also fail if a pinned case is no longer in the suite, if a case passes that is known "
        "to fail, or if a remark on a log is not pinned."),
    "--junit": Keyword(PATH, "Also write the results as JUnit XML.", takes="FILE"),
    **JSON,
    "-q --quiet": Keyword(flag, "Only failures and the totals."),
    "-v --verbose": Keyword(flag, "A line for every case that passes, and all remarks on logs."),
}  # fmt: skip


CI_VARIABLES = (
    *("CI", "TF_BUILD", "TEAMCITY_VERSION", "CODEBUILD_BUILD_ID", "JENKINS_URL", "HUDSON_URL"),
    *("bamboo_buildKey", "GO_PIPELINE_NAME", "HARNESS_BUILD_ID"),
)
"""CI, and the variables of services of continuous integration that do not set it."""


ABOUT = """Compare recorded logs with references.

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
the suite. Run a new suite once with --update: it writes the references, and SUITE.lock.json,
which pins the SHA-256 of the inputs and the options of each case. Keep all of them with the
suite. Use pin-log = false where the system under test makes the log, skip = "REASON" to omit
a case, and xfail = "REASON" for a case that is known to fail.

Exit code 0: all pass; 1: a case failed; 2: there was an error (a log is missing, or something
that is pinned changed), whatever the other cases do. A case that changed is compared with its
old reference all the same; --update replaces what it pins, and --dry-run shows that before.
"""
"""The help of the command."""


@click.command(cls=Command, help=ABOUT, examples=EXAMPLES, grouped=False, no_args_is_help=True)
@click.argument("suite", type=PATH, metavar="SUITE.toml")
@click.argument("logs", type=PATH, metavar="[LOG...]", nargs=-1)
@click.option(
    "-k",
    "patterns",
    metavar="EXPR",
    multiple=True,
    help="Only the case named EXPR, or else those whose names contain it, or match it where it has "
    "*, ? or [...]; can be repeated.  [default: all]",
)
@with_options(OPTIONS)
def command(suite: str, logs: tuple[str, ...], **options: Any) -> int:
    """Compare recorded logs with references; returns the exit code."""
    from quatprop.tools.check.case import exit_code
    from quatprop.tools.check.changes import explain, is_usable
    from quatprop.tools.check.runner import report_of
    from quatprop.tools.check.selection import Wanted, new_suite, select_cases

    updating, dry_run = options["update"] or options["init"], options["dry_run"]
    with ExitStack() as stack:
        stack.enter_context(errors_reported_to_ci(Path(suite), options))
        _refuse_contradictions(logs, options)
        if options["init"]:
            name = options["reference_log"]
            series = None if name is None else input_of(name, options, side="b")
            stack.enter_context(new_suite(suite, logs, series))
        wanted = Wanted(options["patterns"], updating, options["force"], dry_run)
        selection = select_cases(suite, wanted)
        if options["explain"]:
            pins, cases = selection.pins, selection.cases
            click.echo("\n\n".join(explain(case, pins.get(case.name)) for case in cases))
            return 0 if all(map(is_usable, cases)) else 2
        selection.refuse_targets(options["junit"], updating=updating)
        results = run_and_show(selection, options)
    code = exit_code(results)
    if options["as_json"]:
        report = report_of(selection.suite, results, passed=not code)
        click.echo(json.dumps(report, indent=2))
    elif options["init"]:
        report_new(selection.suite, results)
    if updating:
        for line in selection.removal_lines(written=not dry_run):
            click.echo(line, err=True)
    return code


def _refuse_contradictions(logs: Sequence[str], options: Mapping[str, Any]) -> None:
    """Refuse options without those that they require, and an update on CI."""
    if options["init"] != bool(logs):
        raise click.UsageError("--init needs a LOG for each case, and nothing else takes one")
    if options["reference_log"] and not options["init"]:
        raise click.UsageError("--reference-log requires --init; in a suite, it is a key")
    for name in ("topic_b", "on_invalid"):
        if options[name] and not options["reference_log"]:
            raise click.UsageError(f"--{name.replace('_', '-')} requires --reference-log")
    updating = options["update"] or options["init"]
    for name in ("dry_run", "interactive", "force"):
        if options[name] and not (options["update"] or (updating and name == "force")):
            raise click.UsageError(f"--{name.replace('_', '-')} requires --update")
    if options["interactive"] and options["processes"] > 1:
        raise click.UsageError("--interactive asks about one case at a time; omit -j")
    service = next((name for name in CI_VARIABLES if _is_set(name)), None)
    if updating and service and not options["force"] and not options["dry_run"]:
        raise click.UsageError(
            f"{service} is set, so nobody would review the references that this writes; run it on "
            f"your machine, {'' if options['init'] else 'preview it with --dry-run, '}or write "
            "them anyway with --force"
        )


def _is_set(variable: str) -> bool:
    return os.environ.get(variable, "").lower() not in {"", "0", "false"}


# Run the cases of a suite, and show their results in the terminal and to CI services.


MAX_LISTED = 8
"""Maximum number of cases for which those that pass are listed."""


def run_and_show(selection: Selection, options: Any) -> list[CaseResult]:
    """Run cases, show their results, failures last, and return them."""
    from quatprop.tools.check.case import CaseResult
    from quatprop.tools.check.runner import CheckOptions, note_lines, run_cases, totals

    suite, cases = selection.suite, selection.cases
    width = max((len(plain(case.name)) for case in cases), default=0)
    run_options = CheckOptions(
        suite=suite if options["update"] or options["init"] else None,
        orphans=selection.orphans,
        removed=selection.removed,
        dry_run=options["dry_run"],
        force=options["force"],
        confirm=partial(_confirmed, width) if options["interactive"] else None,
        artifacts=options["artifacts"] and Path(options["artifacts"]),
        strict=options["strict"],
    )
    running = run_cases(cases, selection.pins, run_options, options["processes"])
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
    from quatprop.tools.check.runner import NEEDS_ATTENTION, result_text

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
    from quatprop.tools.check.runner import result_text

    click.echo(result_text(result, width), err=True)
    try:
        return click.confirm("accept?", err=True)
    except click.Abort:
        click.echo(err=True)
        return False


def report_new(suite: Suite, results: Sequence[CaseResult]) -> None:
    """Report what was written for a new suite."""
    written = sum(result.pin is not None for result in results)
    if not written:
        click.echo("wrote nothing, as no log could be propagated", err=True)
        return
    of = "" if written == len(results) else f" of {written} of {len(results)} cases"
    click.echo(f"wrote {suite.path}, {suite.lock} and the references{of}", err=True)


@contextmanager
def errors_reported_to_ci(suite: Path, options: Mapping[str, Any]) -> Iterator[None]:
    """Also report an error that ends the run to CI, where reports of an earlier run may remain."""
    from quatprop.tools.check.case import CaseResult

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
    from quatprop.tools.check.runner import append_github_summary, github_annotations, write_junit

    if options["junit"] is not None:
        write_junit(options["junit"], suite, results)
    if summary := os.environ.get("GITHUB_STEP_SUMMARY"):
        append_github_summary(summary, suite, results)
    if os.environ.get("GITHUB_ACTIONS") == "true":
        for annotation in github_annotations(suite, results):
            click.echo(annotation, err=True)
    if options["artifacts"] is not None:
        from quatprop.tools.check.runner import write_overview

        try:
            write_overview(Path(options["artifacts"]), suite, results)
        except (OSError, QuatpropError) as error:
            click.echo(f"the overview cannot be written: {error}", err=True)
