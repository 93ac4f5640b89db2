"""Judge a case: propagate its log, compare the attitudes, and check them against the pin."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.check.case import Case, CaseResult, Verdict
from quatprop.check.case_run import (
    CaseComparison,
    CaseRun,
    compare_case,
    compare_timestamps,
    propagate_case,
)
from quatprop.check.changes import final_distance, hash_inputs, make_pin, obstacles
from quatprop.check.reference import MAX_ROWS, final_of, read_reference, too_sparse
from quatprop.check.remarks import loss_notes, remarks_of
from quatprop.errors import QuatpropError
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.logs.attitude_input import load_attitudes
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.check.lock import Pin
    from quatprop.logs.attitude_input import LoadedAttitudes
    from quatprop.text import Remark


SAME_DEG = 1e-5
"""Upper bound on the rounding of the angles in a lock, deg."""


class Judgement(NamedTuple):
    """The result of a case, and the data it is based on.

    `reference`, `comparison`: None if there is no reference
    `new_pin`: the pin of an update, without its stored reference
    `remarks`: remarks on the log and the reference, by code
    """

    result: CaseResult
    run: CaseRun
    reference: LoadedAttitudes | None
    comparison: CaseComparison | None
    new_pin: Pin
    remarks: dict[str, Remark]


def judge(case: Case, pin: Pin | None, folder: Path) -> Judgement:
    """Compare a case with its reference, even if it does not match its pin.

    `pin`: None if the case was never updated
    `folder`: for the file of attitudes
    """
    hashes = hash_inputs(case, pin)
    changed = obstacles(case, pin, hashes)
    try:
        run = propagate_case(case, _decimation(case, pin), folder)
        reference = _reference(case, may_be_broken=bool(changed))
    except QuatpropError as error:
        if changed:
            raise QuatpropError(f"{changed}; it cannot be compared now: {error}") from error
        if pin is not None and case.pins_log:
            used = f"the same bytes could be used by quatprop {pin.quatprop}"
            raise QuatpropError(f"{error}; {used}") from error
        raise
    comparison = None
    if reference is not None and case.external is None and pin is not None:
        # References pinned by an earlier version may be too sparse.
        changed = changed or too_sparse(case, reference.series, pin.samples, pin.span_s)
    if reference is not None:
        comparison = compare_case(case, run.series, reference.series)
    remarks = remarks_of(case, run, reference, comparison)
    notes: list[str] = [*loss_notes(case, run, reference)]
    if pin is not None and pin.quatprop != __version__:
        notes.append(
            f"the reference file was made by quatprop {pin.quatprop}, this is {__version__}"
        )
    unpinned = [code for code in remarks if pin and code not in pin.remarks]
    notes += [text for code, text in remarks.items() if code in unpinned and text not in notes]
    failures = [*filter(None, _failures(case, pin, run, reference, comparison))]
    result = result_of(case, comparison, changed, failures, notes)
    result = result._replace(remarks=tuple(remarks.values()), unpinned=tuple(unpinned))
    new_pin = make_pin(case, run, comparison, hashes, remarks)
    return Judgement(result, run, reference, comparison, new_pin, remarks)


def result_of(
    case: Case,
    comparison: CaseComparison | None,
    changed: str,
    failures: Sequence[str],
    notes: Sequence[str],
) -> CaseResult:
    """Return the result of a case.

    `changed`: differences from the pin, and the way out; empty if there are none
    `failures`: why the attitudes are not accepted
    """
    impossible = comparison.impossible if comparison else ""
    verdict: Verdict = "error" if changed or impossible else "fail" if failures else "pass"
    reasons = [changed, impossible, *failures]
    if failures and comparison and comparison.cause:
        reasons.append(f"likely cause: {comparison.cause}")
    reason = "" if verdict == "pass" else "; ".join(filter(None, [*reasons, *notes]))
    result = CaseResult(case.name, verdict, reason, notes=tuple(notes))
    if comparison is None or comparison.result is None:
        return result
    return result._replace(
        summary=comparison.summary,
        error_rad=comparison.result.worst.error_rad,
        limits=comparison.limits,
        comparison=comparison.result.report(),
        trace=comparison.trace,
    )


def _decimation(case: Case, pin: Pin | None) -> int | None:
    """Return N, where judging a case needs every N-th attitude; None if it needs all."""
    if case.reference is None or not case.strict:
        # Missing samples shift the decimation: find the reference timestamps among all samples.
        return None
    if pin is not None:
        return pin.every
    return None if Path(case.reference).exists() else MAX_ROWS


def _reference(case: Case, *, may_be_broken: bool) -> LoadedAttitudes | None:
    """Return the reference of a case; None if there is none yet.

    `may_be_broken`: return None for an unreadable reference, whose change is reported already
    """
    if case.external is not None:
        return load_attitudes(case.external)
    path = str(case.reference)
    if not Path(path).exists():
        return None
    try:
        return read_reference(path)
    except QuatpropError:
        if may_be_broken:
            return None
        raise


def _failures(
    case: Case,
    pin: Pin | None,
    run: CaseRun,
    reference: LoadedAttitudes | None,
    comparison: CaseComparison | None,
) -> Iterator[str]:
    """Yield why the attitudes are not accepted; some sentences may be empty."""
    if pin is not None and run.samples != pin.samples and case.pins_log:
        yield f"{run.samples} samples were propagated, and {pin.samples} when pinned"
    if comparison is None or reference is None:
        return
    final = final_of(reference) if case.external is None else None
    if case.external is None and pin is not None:
        if final is None:
            yield "the reference file does not say what it was made from: check did not write it"
        elif (apart := math.degrees(final_distance(pin, np.array(final)))) > SAME_DEG:
            yield (
                f"the last attitudes in the lock and in the reference file are {apart:.6g} "
                f"deg apart"
            )
        if case.strict:
            yield compare_timestamps(run.series, reference.series)
    yield comparison.failure
    comparable = case.strict and case.comparison.align == "none" and comparison.result
    if final is not None and comparable and not comparison.failure:
        # The rows of the reference may lack the last sample.
        error = float(geodesic_angle(np.array(final), run.report.result.final_wxyz))
        if error > case.comparison.limit_rad:
            apart_text = f"{case.angle_text(error)} from the one in the reference file"
            yield f"the attitude at the last sample is {apart_text}"
