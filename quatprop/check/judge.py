"""Judge a case: refuse what differs from the lock, then compare the attitudes; or explain that."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from quatprop.check.case import Case, CaseNotRun, CaseResult
from quatprop.check.case_run import compare_case, compare_timestamps, propagate_case, try_compare
from quatprop.check.cases import LIMITS, same_option
from quatprop.check.lock import DIGITS, Pin, describe_change, digests_of, sha256_of
from quatprop.check.reference import DEFAULT, describe_provenance, read_reference
from quatprop.comparison.settings import Sigmas
from quatprop.errors import LogError, QuatpropError
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.logs.attitude_input import AttitudeInput, load_attitudes
from quatprop.settings.spelling import in_keys
from quatprop.text import Setting, listed, plain, quoted, spelling
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from quatprop.check.case_run import CaseComparison, CaseRun

OTHER_VERSION = "the reference was made by quatprop"
"""How the note on another version begins."""


def judge(case: Case, pin: Pin | None) -> CaseResult:
    """Compare a case with its reference.

    `pin`: what it depended on when it was last updated; None if it never was
    """
    hashes = hash_inputs(case)
    update = Setting("update")
    if pin is None and case.reference is not None and Path(case.reference).exists():
        reason = "the reference is there, but not in the lock; restore the lock, or check with "
        _refuse(case, f"{reason}{update}")
    if pin is None:
        reason = "the lock has no entry for this case yet; run quatprop check with "
        _refuse(case, f"{reason}{update}, and look at what it writes")
    _refuse_changes(case, pin, hashes)
    notes = []
    if pin.quatprop != __version__:
        notes.append(f"{OTHER_VERSION} {pin.quatprop}, this is {__version__}")
    try:
        # Samples that are missing move the others: all are needed to find those of the reference.
        run = propagate_case(case, pin.every if case.strict else None)
    except LogError as error:
        if not case.pins_log:
            raise
        reason = f"{error}; the same bytes could be used by quatprop {pin.quatprop}"
        return CaseResult(case.name, "error", reason)
    failures = []
    if run.samples != pin.samples and case.pins_log:
        failures.append(f"{run.samples} samples were propagated, and {pin.samples} when pinned")
    if case.external is not None:
        return judge_by(case.external, case, run, failures, notes)
    reference = read_reference(str(case.reference)).series
    if case.strict:
        failures.append(compare_timestamps(run.series, reference))
    comparison = try_compare(case, run.series, reference)
    if not comparison.failure:
        failures.append(_compare_last(case, pin, run))
    return _judged(case, run, comparison, failures, [*notes, *loss_notes(case, run)])


def judge_by(
    external: AttitudeInput,
    case: Case,
    run: CaseRun,
    failures: Iterable[str] = (),
    notes: Iterable[str] = (),
) -> CaseResult:
    """Return the result of a case by an independent series."""
    loaded = load_attitudes(external)
    notes = [*notes, *loss_notes(case, run)]
    if loaded.data_lost:
        notes.append(f"data of {plain(external.path)} were lost or left out, see compare")
    comparison = compare_case(case, run.series, loaded.series)
    return _judged(case, run, comparison, failures, notes)


def loss_notes(case: Case, run: CaseRun) -> list[str]:
    """Return a note where data of the log were lost."""
    lost = f"data of {plain(case.log)} were lost or left out, see propagate"
    return [lost] if run.report.data_lost else []


def _judged(
    case: Case,
    run: CaseRun,
    comparison: CaseComparison,
    failures: Iterable[str],
    notes: Iterable[str],
) -> CaseResult:
    """Return the result of a case."""
    failures = [*filter(None, [*failures, comparison.failure])]
    if failures and comparison.cause:
        failures.append(f"likely cause: {comparison.cause}")
    return CaseResult(
        name=case.name,
        verdict="fail" if failures else "pass",
        reason="; ".join([*failures, *notes]) if failures else "",
        summary=comparison.summary,
        error_rad=comparison.error_rad,
        notes=tuple(notes),
        remarks=run.remarks,
        comparison=comparison.report,
    )


def hash_inputs(case: Case) -> dict[str, str]:
    """Return the SHA-256 of every input that must not change, by key of the suite.

    Of a folder, that of each file which is read, by key and name: ``log/metadata.yaml``.
    """
    return {
        f"{key}/{name}" if name else key: digest
        for key, path in case.inputs.items()
        if case.pins_log or key != "log"
        for name, digest in digests_of(path).items()
    }


def differences(
    old: Mapping[str, str], new: Mapping[str, str]
) -> list[tuple[str, str | None, str | None]]:
    """Return key, old value and new value of every entry that differs."""
    return [
        (key, old.get(key), new.get(key))
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]


def option_differences(pin: Pin, case: Case) -> list[tuple[str, str | None, str | None]]:
    """Return the options that have another value than the pinned one, however it is written."""
    return [
        (key, old, new)
        for key, old, new in differences(pin.options, case.options)
        if not same_option(key, old, new)
    ]


def option_text(value: str | None) -> str:
    """Return the value of an option in quotes; None is the default."""
    return DEFAULT if value is None else quoted(value)


def _refuse_changes(case: Case, pin: Pin, hashes: Mapping[str, str]) -> None:
    """Refuse a case that is not as it was pinned."""
    accept = f"; restore it, or accept it with {Setting('update')}"
    for key, old, new in differences(pin.inputs, hashes):
        base, _, name = key.partition("/")
        path = case.inputs.get(base)
        # Which inputs there are depends on options, which are compared below.
        if path is None or (not name and (old is None or new is None)):
            continue
        file = Path(path, name) if name else Path(path)
        raise LogError(file, f"{describe_change(file, old, new)}{accept}")
    if options := option_differences(pin, case):
        changes = ", ".join(
            f"{key} was {option_text(old)} and is now {option_text(new)}"
            for key, old, new in options
        )
        _refuse(case, f"the case has changed since it was pinned: {changes}{accept}")
    if _keys(pin.inputs) != _keys(hashes) or (pin.reference is None) != (case.reference is None):
        _refuse(case, f"the case was pinned with another kind of reference{accept}")
    if case.reference is None:
        return
    if not Path(case.reference).exists():
        _refuse(case, f"the reference is missing; restore it, or write it with {Setting('update')}")
    if (new := sha256_of(case.reference)) != pin.reference:
        _refuse(
            case,
            f"this is not the reference that was pinned (SHA-256 {str(pin.reference)[:DIGITS]}, "
            f"now {new[:DIGITS]}){describe_provenance(case, pin)}; restore it, or write it anew "
            f"with {Setting('update')}",
        )


def _keys(hashes: Mapping[str, str]) -> set[str]:
    return {key.partition("/")[0] for key in hashes}


def _refuse(case: Case, reason: str) -> NoReturn:
    """Refuse a case, with the file that its error is about."""
    raise LogError(case.reference or case.inputs["log"], reason)


def _compare_last(case: Case, pin: Pin, run: CaseRun) -> str:
    """Return how the last attitude differs, which the reference may lack."""
    if not case.strict or case.comparison.align != "none":
        return ""
    error = float(geodesic_angle(np.array(pin.final_wxyz), run.report.result.final_wxyz))
    if error <= case.comparison.limit_rad:
        return ""
    angle = case.angle_text(error)
    return f"the attitude at the last sample is {angle} from the one that was pinned"


@spelling(in_keys)
def explain(case: Case | CaseNotRun, pin: Pin | None) -> str:
    """Return what a case depends on, what is pinned, and how it is judged.

    `pin`: what the lock has of it; None if nothing
    """
    lines = [f"{plain(case.name)} (line {case.line} of the suite)"]
    facts = [("", plain(case.reason))] if isinstance(case, CaseNotRun) else [*_facts(case, pin)]
    width = max(10, *(len(name) for name, _ in facts))
    return "\n".join([*lines, *(f"  {name:<{width}} {text}".rstrip() for name, text in facts)])


def _facts(case: Case, pin: Pin | None) -> Iterator[tuple[str, str]]:
    for key, path in case.inputs.items():
        pinned = {
            name.partition("/")[2]: digest
            for name, digest in (pin.inputs.items() if pin else ())
            if name.partition("/")[0] == key
        }
        yield key, _state(path, pinned)
    pinned_options = pin.options if pin else case.options
    for key in sorted(pinned_options.keys() | case.options.keys()):
        was, now = (plain(by.get(key) or DEFAULT) for by in (pinned_options, case.options))
        yield key, now if was == now else f"{now}, pinned as {was}"
    if case.reference is not None:
        pinned = {"": pin.reference} if pin and pin.reference else {}
        yield "reference", _state(case.reference, pinned)
    elif case.external is not None:
        yield "reference", f"{plain(case.external.path)}, an independent series"
    comparison = case.comparison
    if (tolerance := comparison.tol) is not None:
        limit = str(tolerance) if isinstance(tolerance, Sigmas) else case.angle_text(tolerance)
        yield "judged by", f"worst error of at most {limit}, alignment {comparison.align}"
    else:
        yield "judged by", f"alignment {comparison.align}"
    for key in sorted(LIMITS & case.comparison_options.keys() - {"tol"}):
        yield "", f"{key} {plain(case.comparison_options[key])}"
    if case.external is None:
        yield "", "equal timestamps" if case.strict else "timestamps may differ"
    if pin is not None and (case.strict or case.pins_log):
        yield "", f"{pin.samples} samples"
    if case.xfail:
        yield "xfail", plain(case.xfail)
    if pin is None:
        yield "lock", "no entry"
        return
    every = f", one of every {pin.every} attitudes" if pin.every and pin.every > 1 else ""
    yield "lock", f"by quatprop {pin.quatprop}{every}"


def _state(path: str, pinned: Mapping[str, str]) -> str:
    """Return a path, and how its files, by name, differ from those that were pinned."""
    if not pinned:
        return f"{plain(path)}: not pinned"
    try:
        digests = digests_of(path)
    except QuatpropError as error:
        return str(error)
    changed = [name for name, *_ in differences(pinned, digests)]
    if set(digests) != {""}:
        now, was = f"{len(digests)} files", listed(map(plain, changed))
    else:
        now, was = f"SHA-256 {digests[''][:DIGITS]}", pinned.get("", "")[:DIGITS]
        was = f"{now}, pinned {was}"
    return f"{plain(path)}: " + (f"changed: {was}" if changed else f"{now}, as pinned")
