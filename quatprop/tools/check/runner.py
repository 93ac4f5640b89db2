"""Run cases, one after another or in processes, with results in the order of the suite."""

from __future__ import annotations

import time
from contextlib import closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

from quatprop.check.case import Case, CaseNotRun, CaseResult
from quatprop.check.judge import Judgement, judge
from quatprop.check.lock import Pin, merge_into_lock
from quatprop.check.update import Baseline, propose, put_in_place, refuse_target
from quatprop.concurrency.processes import KILLED, in_order, map_processes
from quatprop.errors import QuatpropError
from quatprop.errors.third_party import as_user_error
from quatprop.settings.spelling import in_keys
from quatprop.text import Setting, plain, spelled, spelling
from quatprop.writers.targets import output_errors

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Mapping, Sequence

    from quatprop.check.suite import Suite

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
        result = CaseResult(case.name, case.verdict, case.reason)
        result = _apply_strict(result) if options.strict else result
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
    # An update would make a known failure pass.
    suite = None if case.xfail and pin else options.suite
    if suite is not None:
        refuse_target(case, pin, suite.lock.parent)
    judged = judge(case, pin, scratch)
    if suite is not None:
        judged = judged._replace(result=_updated(case, pin, judged, options, scratch))
    result = _apply_xfail(case, judged.result)
    if result.verdict == "error" and options.suite is not suite:
        reason = spelled(f"{result.reason}; {Setting('update')} leaves it as it is, because of")
        result = result._replace(
            reason=f"{reason} xfail, so that no failure is pinned: take it out"
        )
    if options.strict:
        result = _apply_strict(result)
    if options.artifacts is not None and result.verdict in {"fail", "error", "xfail"}:
        return _with_evidence(case, judged._replace(result=result), options)
    return result


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
    put_in_place(case, proposal)
    return proposal.result


def _apply_xfail(case: Case, result: CaseResult) -> CaseResult:
    """Return the result of a case, allowing for a known failure."""
    if case.xfail and result.verdict == "fail":
        return result._replace(verdict="xfail", reason=f"{case.xfail}: {result.reason}")
    if case.xfail and result.verdict == "pass":
        return result._replace(verdict="xpass", reason=f"it is known to fail: {case.xfail}")
    return result


def _apply_strict(result: CaseResult) -> CaseResult:
    """Return a result under ``--strict``: one that needs attention is a failure."""
    strict = spelled(f"with {Setting('strict')} this is a failure")
    if result.verdict in {"xpass", "deleted"}:
        return result._replace(verdict="fail", reason=f"{result.reason}; {strict}")
    if result.verdict == "pass" and result.unpinned:
        reasons = [f"not pinned: {note}" for note in result.notes]
        return result._replace(verdict="fail", reason="; ".join([*reasons, strict]))
    return result


def _with_evidence(case: Case, judged: Judgement, options: CheckOptions) -> CaseResult:
    """Keep the evidence of a failure, and add its folder, or why it is missing, to the reason."""
    from quatprop.check.artifacts import write_artifacts  # matplotlib, for failures only

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
