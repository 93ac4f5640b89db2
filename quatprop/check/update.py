"""Make the reference of a case anew, and say what changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop import __version__
from quatprop.check.case import Case, Outcome
from quatprop.check.judge import DIGITS, changed, figure, hashes_of, judge, said
from quatprop.check.lock import Pin, sha256_of
from quatprop.check.measure import angle_text, chooses_rows, compared, difference, measured
from quatprop.check.reference import ROWS, read_reference, refuse_foreign, thinning, write_reference
from quatprop.errors import QuatpropError
from quatprop.signals.compared_series import read_operand
from quatprop.text import plain
from quatprop.writers.overlap import refuse_overlap

if TYPE_CHECKING:
    from quatprop.check.measure import Measured


def update(case: Case, pin: Pin | None) -> Outcome:
    """Store the reference of a case, or pin what it rests on where that is elsewhere.

    A case that passes as it is, on what it rests on, is left alone: references that moved a
    little at every update would creep.

    Raises
    ------
    QuatpropError
        The case cannot be run, or its reference not be written.
    """
    hashes = hashes_of(case)
    if case.reference is not None:
        refuse_overlap(case.inputs.values(), [case.reference])
        if pin is None or pin.reference is None:
            refuse_foreign(Path(case.reference))
    if pin is not None and (kept := _kept(case, pin)) is not None:
        return kept
    now, every = _thinned(case, pin)
    changes = _changes(case, pin, now, hashes)
    if case.reference is None:
        return _pinned_elsewhere(case, pin, now, hashes, changes)
    changes += _difference_from_the_old(case, now)
    write_reference(case, now, hashes, every)
    return Outcome(
        name=case.name,
        verdict="pass",
        figure=f"{len(now.series)} of {now.samples} attitudes in {plain(case.reference)}",
        changes=tuple(changes),
        updated="new" if pin is None else "updated",
        pin=_pin(case, now, hashes, every=every, reference=sha256_of(case.reference)),
    )


def _kept(case: Case, pin: Pin) -> Outcome | None:
    """Return the outcome of a case that passes as it is; None if something is to be done."""
    try:
        outcome = judge(case, pin)
    except QuatpropError:
        return None
    if outcome.verdict != "pass":
        return None
    return Outcome(
        name=case.name,
        verdict="pass",
        figure=outcome.figure,
        error_rad=outcome.error_rad,
        notes=outcome.notes,
        updated="kept",
        comparison=outcome.comparison,
        pin=pin,
    )


def _thinned(case: Case, pin: Pin | None) -> tuple[Measured, int | None]:
    """Run a case so that about :data:`ROWS` attitudes are kept, where it does not say which."""
    if chooses_rows(case) or case.reference is None:
        return measured(case, None), None
    # How long the log is shows only when it was run.
    guess = pin.every if pin and pin.every else ROWS
    now = measured(case, guess)
    every = thinning(now.samples)
    return (now if every == guess else measured(case, every)), every


def _pinned_elsewhere(
    case: Case, pin: Pin | None, now: Measured, hashes: dict[str, str], changes: list[str]
) -> Outcome:
    """Judge a case against a series from elsewhere, and pin what it rests on."""
    if case.external is None:
        raise ValueError(case.external)
    found = difference(case, now.series, read_operand(case.external).series)
    if pin is not None and pin.error_rad is not None and pin.error_rad != found.error_rad:
        old, new = (
            angle_text(angle, in_degrees=case.in_degrees)
            for angle in (pin.error_rad, found.error_rad)
        )
        changes.append(f"worst error: {old} -> {new}")
    reasons = [found.reason, f"likely cause: {found.cause}" if found.cause else ""]
    return Outcome(
        name=case.name,
        verdict="pass" if found.passed else "fail",
        reason="" if found.passed else "; ".join(filter(None, reasons)),
        figure=figure(case, found),
        error_rad=found.error_rad,
        changes=tuple(changes),
        updated="new" if pin is None else "updated",
        comparison=found.report,
        pin=_pin(case, now, hashes, error_rad=found.error_rad),
    )


def _pin(
    case: Case,
    now: Measured,
    hashes: dict[str, str],
    **found: Any,
) -> Pin:
    nothing = {"every": None, "reference": None, "error_rad": None}
    return Pin(
        quatprop=__version__,
        inputs=hashes,
        options=case.options,
        samples=now.samples,
        final_wxyz=now.final_wxyz,
        **{**nothing, **found},
    )


def _changes(case: Case, pin: Pin | None, now: Measured, hashes: dict[str, str]) -> list[str]:
    """Say what a case rests on now and did not before."""
    if pin is None:
        return []
    changes = [
        f"{key}: SHA-256 {(was or 'none')[:DIGITS]} -> {(is_ or 'none')[:DIGITS]}"
        for key, was, is_ in changed(pin.inputs, hashes)
    ]
    changes += [
        f"{key}: {said(was)} -> {said(is_)}" for key, was, is_ in changed(pin.options, case.options)
    ]
    if pin.quatprop != __version__:
        changes.append(f"quatprop: {pin.quatprop} -> {__version__}")
    if pin.samples != now.samples:
        changes.append(f"samples: {pin.samples} -> {now.samples}")
    return changes


def _difference_from_the_old(case: Case, now: Measured) -> list[str]:
    """Say how far the attitudes are from the reference that is replaced."""
    if not Path(str(case.reference)).exists():
        return []
    try:
        old = read_reference(str(case.reference)).series
    except QuatpropError as error:
        return [f"the old reference could not be read: {error}"]
    found = compared(case, now.series, old)
    if isinstance(found, str):
        return [f"attitudes: not comparable with the old reference: {found}"]
    angle = angle_text(found.error_rad, in_degrees=case.in_degrees)
    likely = f"; likely cause: {found.cause}" if found.cause and not found.passed else ""
    return [f"attitudes: up to {angle} from the old reference, {found.where}{likely}"]
