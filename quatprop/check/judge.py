"""Judge a case: whether all that it rests on is as it was, and whether its attitudes are."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quatprop import __version__
from quatprop.check.case import BrokenCase, Case, Outcome
from quatprop.check.lock import sha256_of
from quatprop.check.measure import (
    Difference,
    angle_text,
    compared,
    difference,
    differing_stamps,
    measured,
)
from quatprop.check.reference import differing_provenance, read_reference
from quatprop.check.spelling import sentence
from quatprop.errors import LogError, QuatpropError
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.signals.compared_series import read_operand
from quatprop.text import plain, quoted
from quatprop.third_party_errors import as_user_error

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.check.lock import Pin
    from quatprop.check.measure import Measured

DIGITS = 12
"""How much of a SHA-256 is shown."""

LFS = b"version https://git-lfs"
"""How a file begins that stands for one that Git LFS has not brought."""


def settled(
    case: Case | BrokenCase, work: Callable[[Case, Pin | None], Outcome], pin: Pin | None
) -> Outcome:
    """Do something with a case; an error becomes its outcome.

    Parameters
    ----------
    case
        The case; a broken one is an error at once.
    work
        :func:`judge`, or an update.
    pin
        What it rested on.
    """
    if isinstance(case, BrokenCase):
        return Outcome(case.name, "error", case.reason, line=case.line)
    began = time.perf_counter()
    try:
        outcome = work(case, pin)
    except QuatpropError as error:
        outcome = Outcome(case.name, "error", sentence(error))
    except Exception as error:
        if (known := as_user_error(error)) is None:
            raise
        outcome = Outcome(case.name, "error", sentence(known))
    return replace(outcome, seconds=time.perf_counter() - began, line=case.line)


def judge(case: Case, pin: Pin | None) -> Outcome:
    """Hold a case against its reference.

    Parameters
    ----------
    case
        The case.
    pin
        What it rested on when it was last updated; None if it never was.

    Raises
    ------
    QuatpropError
        It cannot be judged: an input is missing, or something that it rests on has changed.
    """
    hashes = hashes_of(case)
    if pin is None:
        raise LogError(
            case.reference or case.inputs["log"],
            "nothing is pinned for this case yet; run quatprop check with --update, and look at "
            "what it writes",
        )
    _refuse_changes(case, pin, hashes)
    notes = [] if pin.quatprop == __version__ else [_made_by(pin)]
    try:
        now = measured(case, pin.every)
    except LogError as error:
        if not case.pins_log:
            raise
        reason = f"{error}; the same bytes could be used by quatprop {pin.quatprop}"
        return Outcome(case.name, "error", reason)
    if now.report["data_lost"]:
        notes.append(f"of {plain(case.job.log)} something was lost or left out, see propagate")
    reasons = []
    if now.samples != pin.samples and (case.strict or case.pins_log):
        reasons.append(
            f"{now.samples} samples were propagated, and {pin.samples} when it was pinned"
        )
    found: Difference | str
    if case.external is not None:
        found = difference(case, now.series, read_operand(case.external).series)
    else:
        stored = read_reference(str(case.reference)).series
        if case.strict and (words := differing_stamps(now.series, stored)):
            reasons.append(words)
        found = compared(case, now.series, stored)
        reasons += _different_end(case, pin, now, found)
    return _outcome(case, found, reasons, notes)


def _outcome(case: Case, found: Difference | str, reasons: list[str], notes: list[str]) -> Outcome:
    """Put together what was found."""
    if isinstance(found, str):
        return Outcome(case.name, "fail", "; ".join([*reasons, found, *notes]))
    reasons += [found.reason] if found.reason else []
    if reasons and found.cause:
        reasons.append(f"likely cause: {found.cause}")
    return Outcome(
        name=case.name,
        verdict="fail" if reasons else "pass",
        reason="; ".join([*reasons, *notes]) if reasons else "",
        figure=figure(case, found),
        error_rad=found.error_rad,
        notes=tuple(notes),
        comparison=found.report,
    )


def figure(case: Case, found: Difference) -> str:
    """Return the worst error against the tolerance, and where it is."""
    tolerance = case.settings.tolerance
    limit = "" if tolerance is None else f" of {_angle(case, tolerance)}"
    return f"{_angle(case, found.error_rad)}{limit} {found.where}"


def _angle(case: Case, angle: float) -> str:
    return angle_text(angle, in_degrees=case.in_degrees)


def hashes_of(case: Case) -> dict[str, str]:
    """Return key of the suite -> SHA-256 of every input that has to stay as it is."""
    return {
        key: sha256_of(path) for key, path in case.inputs.items() if case.pins_log or key != "log"
    }


def changed(then: dict[str, str], now: dict[str, str]) -> list[tuple[str, str | None, str | None]]:
    """Return key, value then and value now of everything that is not what it was."""
    return [
        (key, then.get(key), now.get(key))
        for key in sorted(then.keys() | now.keys())
        if then.get(key) != now.get(key)
    ]


def _refuse_changes(case: Case, pin: Pin, hashes: dict[str, str]) -> None:
    """Refuse a case of which something is not as it was pinned."""
    for key, then, now in changed(pin.inputs, hashes):
        if then is None or now is None:
            # Which inputs there are depends on options, which are told below.
            continue
        _refuse_pointer(case.inputs[key])
        raise LogError(
            case.inputs[key],
            f"its content changed since the reference was made (SHA-256 {then[:DIGITS]}, now "
            f"{now[:DIGITS]}); restore it, or accept it with --update",
        )
    if options := changed(pin.options, case.options):
        words = ", ".join(f"{key} is {said(now)}, not {said(was)}" for key, was, now in options)
        raise LogError(
            case.reference or case.inputs["log"],
            f"the case asks for something else than the reference was made with: {words}; restore "
            "it, or accept it with --update",
        )
    if pin.inputs.keys() != hashes.keys() or (pin.reference is None) != (case.reference is None):
        raise LogError(
            case.reference or case.inputs["log"],
            "the case is held against something else than when it was pinned; restore it, or "
            "accept it with --update",
        )
    if case.reference is None:
        return
    if not Path(case.reference).exists():
        raise LogError(
            case.reference, "the reference is not there; restore it, or make it with --update"
        )
    if (now := sha256_of(case.reference)) != pin.reference:
        _refuse_pointer(case.reference)
        raise LogError(
            case.reference,
            f"this is not the reference that was pinned (SHA-256 {str(pin.reference)[:DIGITS]}, "
            f"now {now[:DIGITS]}){differing_provenance(case, pin)}; restore it, or make it anew "
            "with --update",
        )


def _refuse_pointer(path: str) -> None:
    """Say so where a file only stands for one that Git LFS has not brought."""
    if Path(path).is_file():
        with Path(path).open("rb") as stream:
            if stream.read(len(LFS)) == LFS:
                reason = "it only points to a file that Git LFS has not brought; run git lfs pull"
                raise LogError(path, reason)


def said(value: str | None) -> str:
    """Return a value in quotes; what was not said is the default."""
    return "the default" if value is None else quoted(value)


def _made_by(pin: Pin) -> str:
    return f"the reference was made by quatprop {pin.quatprop}, this is {__version__}"


def _different_end(case: Case, pin: Pin, now: Measured, found: Difference | str) -> list[str]:
    """Say how the last attitude differs, which a thinned reference does not hold."""
    comparable = case.strict and case.settings.align == "none"
    if isinstance(found, str) or not found.passed or not comparable:
        return []
    error = float(geodesic_angle(np.array(pin.final_wxyz), np.array(now.final_wxyz)))
    if case.settings.tolerance is None or error <= case.settings.tolerance:
        return []
    return [f"the attitude at the last sample is {_angle(case, error)} from what it was"]
