"""Run cases, one after the other or in processes; results come in the order of the suite."""

from __future__ import annotations

import time
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

from quatprop.check.case import Case, CaseNotRun, CaseResult
from quatprop.check.judge import judge
from quatprop.check.lock import Pin, write_lock
from quatprop.check.update import update
from quatprop.concurrency.processes import KILLED, in_order, map_processes
from quatprop.errors import QuatpropError
from quatprop.errors.third_party import as_user_error
from quatprop.settings.spelling import in_keys
from quatprop.text import plain, spelling
from quatprop.writers.targets import output_errors

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping, Sequence
    from pathlib import Path

    PinnedCase = tuple[Case | CaseNotRun, Pin | None]


@spelling(in_keys)
def run_case(
    pinned: PinnedCase, *, updating: Path | None = None, artifacts: Path | None = None
) -> CaseResult:
    """Judge or update a case; an error becomes its result.

    `artifacts`: where to keep the evidence of a failure; None: nowhere
    """
    case, pin = pinned
    if isinstance(case, CaseNotRun):
        return CaseResult(case.name, case.verdict, case.reason, line=case.line)
    began = time.perf_counter()
    try:
        # An update would make a known failure pass.
        if updating is None or (case.xfail and pin):
            result = judge(case, pin)
        else:
            result = update(case, pin, updating)
        if artifacts is not None and result.verdict == "fail":
            evidence = _keep_evidence(case, pin, artifacts)
            result = result._replace(reason=f"{result.reason}; {evidence}")
    except Exception as error:
        if (user_error := as_user_error(error)) is None:
            raise
        result = CaseResult(case.name, "error", str(user_error))
    if case.xfail and result.verdict == "fail":
        result = result._replace(verdict="xfail", reason=f"{case.xfail}: {result.reason}")
    elif case.xfail and result.verdict == "pass":
        result = result._replace(verdict="xpass", reason=f"it is known to fail: {case.xfail}")
    return result._replace(seconds=time.perf_counter() - began, line=case.line)


def _keep_evidence(case: Case, pin: Pin | None, artifacts: Path) -> str:
    """Keep the evidence of a failure; return where it is, or why it is not there."""
    from quatprop.check.artifacts import write_artifacts  # matplotlib, for failures only

    try:
        with output_errors(artifacts):
            return f"see {plain(write_artifacts(case, pin, artifacts))}"
    except QuatpropError as error:
        return f"its artifacts cannot be kept: {error}"


def run_cases(
    cases: Sequence[Case | CaseNotRun],
    pins: Mapping[str, Pin],
    *,
    lock: Path | None = None,
    artifacts: Path | None = None,
    processes: int = 1,
) -> Generator[CaseResult]:
    """Yield the result of each case, in their order, as soon as those before are done.

    `lock`: update: write references anew, and at the end the lock, with the pins of all other
        cases; None judges
    """
    new_pins = dict(pins)

    def record(result: CaseResult) -> None:
        if result.pin is not None:
            new_pins[result.name] = result.pin

    pinned = [(case, pins.get(case.name)) for case in cases]
    work = partial(run_case, updating=lock and lock.parent, artifacts=artifacts)
    results = map_processes(work, pinned, processes, _killed, record=record)
    try:
        with closing(results):
            yield from in_order(results)
    finally:
        if lock is not None:
            # After an interruption, too: the lock must have the references that were written.
            write_lock(lock, new_pins)


def _killed(pinned: PinnedCase) -> CaseResult:
    case, _ = pinned
    return CaseResult(case.name, "error", KILLED, line=case.line)
