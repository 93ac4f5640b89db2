"""What of a case is not as it was pinned: inputs, options, reference, results."""

from __future__ import annotations

import math
from contextlib import suppress
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.check.case_run import largest_errors
from quatprop.check.cases import same_option
from quatprop.check.lock import (
    DIGITS,
    Pin,
    describe_change,
    digests_of,
    pin_of,
    sha256_of,
    with_content,
)
from quatprop.check.reference import DEFAULT, PROVENANCE_KEY, describe_provenance, provenance_of
from quatprop.conventions.representations import euler_angles, from_euler
from quatprop.errors import QuatpropError, UnreadableLogError
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.rendering import degrees_text
from quatprop.text import Setting, plain, quoted, spelled
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from quatprop.arrays import Float64
    from quatprop.check.case import Case
    from quatprop.check.case_run import CaseComparison, CaseRun

PLACES = 6
"""Decimals of the angles in a lock, deg."""


def hash_inputs(case: Case, pin: Pin | None) -> dict[str, str]:
    """Return the SHA-256 of every input that must not change, by key of the suite.

    Of a folder, that of each file which is read, by key and name: ``log/metadata.yaml``.
    """
    hashes = {}
    for key, path in case.inputs.items():
        if not case.pins_log and key == "log":
            continue
        try:
            digests = digests_of(path)
        except UnreadableLogError as error:
            place, digest = Path(path), pin and pin.inputs.get(key)
            other = digest and with_content(place.parent, f"*{escape(place.suffix)}", digest)
            if not other:
                raise
            reason = f"{error.reason}; {plain(other)} has the same content: name that as {key}"
            raise UnreadableLogError(path, reason) from error
        for name, digest in digests.items():
            hashes[f"{key}/{name}" if name else key] = digest
    return hashes


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


def obstacles(case: Case, pin: Pin | None, hashes: Mapping[str, str]) -> str:
    """Return why a case cannot be judged by its pin, and the way out; empty where it can."""
    found = [*_obstacles(case, pin, hashes)]
    if not found:
        return ""
    sentences, ways_out = zip(*found, strict=True)
    return spelled("; ".join([*sentences, ways_out[-1] + Setting("update")]))


def _obstacles(case: Case, pin: Pin | None, hashes: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield what is not as it was pinned, with its file, and the way out, which ends in update."""
    about = plain(case.reference or case.inputs["log"])
    there = case.reference is not None and Path(case.reference).exists()
    accept = "restore it, or accept it with "
    if pin is None and there:
        reason = "the reference file exists, but is not in the lock"
        yield f"{about}: {reason}", "restore the lock, or check with "
    elif pin is None:
        reason = "the lock has no entry for this case yet"
        yield f"{about}: {reason}", "look at what is written when you run quatprop check with "
    if pin is None:
        return
    for key, old, new in differences(pin.inputs, hashes):
        base, _, name = key.partition("/")
        path = case.inputs.get(base)
        # Which inputs there are depends on options, which are compared below.
        if path is None or (not name and (old is None or new is None)):
            continue
        file = Path(path, name) if name else Path(path)
        yield f"{plain(file)}: {describe_change(file, old, new)}", accept
    options = option_differences(pin, case)
    changed = [
        f"{key} was {option_text(old)} and is now {option_text(new)}" for key, old, new in options
    ]
    before, after = ({key.partition("/")[0] for key in files} for files in (pin.inputs, hashes))
    others = (before ^ after) - {key for key, *_ in options}
    if "log" in others:
        changed.append(f"pin-log was {not case.pins_log} and is now {case.pins_log}".lower())
    if changed:
        yield f"{about}: the case has changed since it was pinned: {', '.join(changed)}", accept
    if others - {"log"} or (pin.reference is None) != (case.reference is None):
        yield f"{about}: the case was pinned with another kind of reference", accept
    elif case.reference is not None and not there:
        yield f"{about}: the reference file is missing", "restore it, or write it with "
    elif case.reference is not None and (now := sha256_of(case.reference)) != pin.reference:
        digests = f"(SHA-256 {str(pin.reference)[:DIGITS]}, now {now[:DIGITS]})"
        reason = f"this is not the reference file that was pinned {digests}"
        reason += describe_provenance(case, pin)
        yield f"{about}: {reason}", "restore it, or write it again with "


def make_pin(
    case: Case,
    run: CaseRun,
    comparison: CaseComparison | None,
    hashes: Mapping[str, str],
    remarks: Iterable[str],
) -> Pin:
    """Return what to pin of a case, but for its stored reference."""
    result = run.report.result
    measured = {}
    if case.external is not None and comparison is not None and comparison.result is not None:
        sizes = zip(("max", "rms", "final"), largest_errors(comparison.result), strict=True)
        measured = {name: _significant(math.degrees(size)) for name, size in sizes}
        for limit, one in zip(comparison.limits, comparison.result.criteria, strict=True):
            in_deg = math.degrees(one.value) if one.unit == "rad" else one.value
            measured[limit.key] = _significant(in_deg)
    return Pin(
        quatprop=__version__,
        inputs=hashes,
        options=case.options,
        samples=run.samples,
        span_s=result.span_s,
        **_angles(result.final_wxyz, result.path_angle_rad),
        remarks=tuple(sorted(remarks)),
        every=None,
        reference=None,
        measured=measured,
    )


def _angles(final_wxyz: Float64, path_angle_rad: float) -> Any:
    """Return the angles that a lock has, deg, by their fields."""
    angles = np.degrees(euler_angles("zyx", final_wxyz[None])[0])
    rounded = (round(float(angle), PLACES) + 0.0 for angle in angles)  # no -0.0
    final = dict(zip(("yaw", "pitch", "roll"), rounded, strict=True))
    return {
        "final_deg": {name: final[name] for name in ("roll", "pitch", "yaw")},
        "total_angle_deg": round(math.degrees(path_angle_rad), PLACES),
    }


def pin_of_reference(path: Path) -> tuple[Pin | None, tuple[str, ...]]:
    """Return what a stored reference says of its case, and the names of the case and its log."""
    with suppress(QuatpropError, LookupError, TypeError, ValueError, AttributeError):
        provenance = provenance_of(str(path))
        told, result = provenance[PROVENANCE_KEY], provenance["result"]
        entry = {key: told[key] for key in ("inputs", "options", "every")}
        entry |= {"quatprop": provenance["quatprop"], "reference": sha256_of(str(path))}
        entry |= {"samples": result["samples"], "span_s": result["span_s"]}
        entry |= _angles(np.array(result["final_wxyz"], float), result["path_angle_rad"])
        pin = pin_of({**entry, "remarks": [], "measured": {}})
        return pin, (str(told["case"]), str(provenance["source"]["path"]))
    return None, ()


def _significant(value: float) -> float:
    return float(f"{value:.6g}")


def change_lines(case: Case, old: Pin, new: Pin, run: CaseRun) -> list[str]:
    """Return what differs between two pins, but for references and remarks."""
    lines = [
        f"{key}: SHA-256 {(was or 'none')[:DIGITS]} -> {(now or 'none')[:DIGITS]}"
        for key, was, now in differences(old.inputs, new.inputs)
    ]
    lines += [
        f"{key}: {option_text(was)} -> {option_text(now)}"
        for key, was, now in option_differences(old, case)
    ]
    if old.quatprop != new.quatprop:
        lines.append(f"quatprop: {old.quatprop} -> {new.quatprop}")
    if old.samples != new.samples:
        lines.append(f"samples: {old.samples} -> {new.samples}")
    turned = f"{old.total_angle_deg:.9g} deg -> {new.total_angle_deg:.9g} deg"
    if old.final_deg != new.final_deg or old.total_angle_deg != new.total_angle_deg:
        # As exact as the angles of a lock.
        apart = degrees_text(round(final_distance(old, run.report.result.final_wxyz), 8))
        lines.append(f"final attitude: {apart} from the one pinned; total angle: {turned}")
    for name in ("max", "rms", "final"):
        was_error, now_error = old.measured.get(name), new.measured.get(name)
        if was_error != now_error and now_error is not None:
            was_text = "none" if was_error is None else f"{was_error} deg"
            lines.append(f"{name} error: {was_text} -> {now_error} deg")
    return lines


def final_distance(pin: Pin, final_wxyz: Float64) -> float:
    """Return the angle between the pinned attitude at the last sample and another, rad.

    Of angles near a pitch of 90 deg, neither roll nor yaw tells how far two attitudes are apart.
    """
    angles = np.radians([[pin.final_deg[name] for name in ("yaw", "pitch", "roll")]])
    return float(geodesic_angle(from_euler("zyx", angles)[0], final_wxyz))
