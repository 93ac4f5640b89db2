"""Update a case: write its reference anew, and list what changed."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.check.case import Case, CaseResult
from quatprop.check.case_run import CaseRun, chooses_rows, propagate_case, try_compare
from quatprop.check.judge import (
    OTHER_VERSION,
    differences,
    hash_inputs,
    judge,
    judge_by,
    loss_notes,
    option_differences,
    option_text,
)
from quatprop.check.lock import DIGITS, Pin, refuse_lfs_pointer, sha256_of
from quatprop.check.reference import (
    MAX_ROWS,
    decimation,
    read_reference,
    refuse_replacing,
    write_reference,
)
from quatprop.errors import QuatpropError
from quatprop.text import plain
from quatprop.version import __version__
from quatprop.writers.targets import refuse_outside, refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Mapping


def update(case: Case, pin: Pin | None, folder: Path) -> CaseResult:
    """Write the reference of a case, and return what to pin.

    A case that passes is left as it is: references that moved a little at every update would
    drift.
    """
    if case.reference is not None:
        refuse_outside(case.reference, folder)
    hashes = hash_inputs(case)
    if case.reference is not None:
        refuse_overlap(case.inputs.values(), [case.reference])
        refuse_lfs_pointer(case.reference)
        if pin is None or pin.reference is None:
            refuse_replacing(Path(case.reference))
    if pin is not None:
        # Whatever has changed, it is updated.
        with suppress(QuatpropError):
            result = judge(case, pin)
            if result.verdict == "pass":
                # It was found to be what this version gives, too.
                kept = pin._replace(quatprop=__version__)
                notes = [note for note in result.notes if not note.startswith(OTHER_VERSION)]
                return result._replace(updated="kept", pin=kept, notes=tuple(notes))
    run, every = _run(case, pin)
    changes = [] if pin is None else _changes(case, pin, run, hashes)
    digest = None
    if case.external is not None:
        result = judge_by(case.external, case, run)
        old, new = pin.error_rad if pin else None, result.error_rad
        if old is not None and new is not None and old != new:
            changes.append(f"worst error: {case.angle_text(old)} -> {case.angle_text(new)}")
    else:
        reference = str(case.reference)
        changes += _compare_with_old(case, run)
        write_reference(case, run, hashes, every)
        digest = sha256_of(reference)
        written = f"{len(run.series)} of {run.samples} attitudes in {plain(reference)}"
        losses = tuple(loss_notes(case, run))
        result = CaseResult(case.name, "pass", summary=written, notes=losses, remarks=run.remarks)
    new_pin = Pin(
        quatprop=__version__,
        inputs=hashes,
        options=case.options,
        samples=run.samples,
        every=every,
        reference=digest,
        final_wxyz=tuple(run.report.result.final_wxyz.tolist()),
        error_rad=result.error_rad,
    )
    updated = "new" if pin is None else "updated"
    return result._replace(changes=tuple(changes), updated=updated, pin=new_pin)


def _run(case: Case, pin: Pin | None) -> tuple[CaseRun, int | None]:
    """Run a case so that its reference has at most :data:`MAX_ROWS` attitudes; return N, too."""
    if chooses_rows(case) or case.reference is None:
        return propagate_case(case, None), None
    # The number of samples is known only after the run.
    guess = pin.every if pin and pin.every else MAX_ROWS
    run = propagate_case(case, guess)
    every = decimation(run.samples)
    return (run if every == guess else propagate_case(case, every)), every


def _changes(case: Case, pin: Pin, run: CaseRun, hashes: Mapping[str, str]) -> list[str]:
    """Return what differs from the pin."""
    changes = [
        f"{key}: SHA-256 {(old or 'none')[:DIGITS]} -> {(new or 'none')[:DIGITS]}"
        for key, old, new in differences(pin.inputs, hashes)
    ]
    changes += [
        f"{key}: {option_text(old)} -> {option_text(new)}"
        for key, old, new in option_differences(pin, case)
    ]
    if pin.quatprop != __version__:
        changes.append(f"quatprop: {pin.quatprop} -> {__version__}")
    if pin.samples != run.samples:
        changes.append(f"samples: {pin.samples} -> {run.samples}")
    return changes


def _compare_with_old(case: Case, run: CaseRun) -> list[str]:
    """Return how far the attitudes are from the reference that is replaced."""
    if not Path(str(case.reference)).exists():
        return []
    try:
        old = read_reference(str(case.reference)).series
    except QuatpropError as error:
        return [f"the old reference could not be read: {error}"]
    comparison = try_compare(case, run.series, old)
    if comparison.error_rad is None:
        return [f"attitudes: not comparable with the old reference: {comparison.failure}"]
    angle = case.angle_text(comparison.error_rad)
    cause = f"; likely cause: {comparison.cause}" if comparison.failure and comparison.cause else ""
    return [f"attitudes: up to {angle} from the old reference, {comparison.where}{cause}"]
