"""Differences between a case and its pin: inputs, options, reference, results."""

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
    """Return the SHA-256 of every pinned input, by key of the suite.

    In a folder each file that is read has its own, by key and name: ``log/metadata.yaml``.
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
    """Return the options whose values differ from the pinned ones, not just in spelling."""
    return [
        (key, old, new)
        for key, old, new in differences(pin.options, case.options)
        if not same_option(key, old, new)
    ]


def option_text(value: str | None) -> str:
    """Return the value of an option in quotes; None means the default."""
    return DEFAULT if value is None else quoted(value)


def obstacles(case: Case, pin: Pin | None, hashes: Mapping[str, str]) -> str:
    """Return the differences from the pin that prevent a verdict, and the way out, or ``""``."""
    differing = [*_obstacles(case, pin, hashes)]
    if not differing:
        return ""
    sentences, ways_out = zip(*differing, strict=True)
    return spelled("; ".join([*sentences, ways_out[-1] + Setting("update")]))


def _obstacles(case: Case, pin: Pin | None, hashes: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield each difference from the pin, with its file, and the way out before "update"."""
    about = plain(case.reference or case.inputs["log"])
    has_file = case.reference is not None and Path(case.reference).exists()
    accept = "restore it, or accept it with "
    if pin is None and has_file:
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
        # The set of inputs depends on options, which are compared below.
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
    elif case.reference is not None and not has_file:
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
    """Return the pin of a case, without its stored reference."""
    result = run.report.result
    measured = {}
    if case.external is not None and comparison is not None and comparison.result is not None:
        sizes = zip(("max", "rms", "final"), largest_errors(comparison.result), strict=True)
        measured = {name: _significant(math.degrees(size)) for name, size in sizes}
        for limit, criterion in zip(comparison.limits, comparison.result.criteria, strict=True):
            value = math.degrees(criterion.value) if criterion.unit == "rad" else criterion.value
            measured[limit.key] = _significant(value)
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
    """Return the angles of a pin, deg, by its fields."""
    angles = np.degrees(euler_angles("zyx", final_wxyz[None])[0])
    rounded = (round(float(angle), PLACES) + 0.0 for angle in angles)  # no -0.0
    final = dict(zip(("yaw", "pitch", "roll"), rounded, strict=True))
    return {
        "final_deg": {name: final[name] for name in ("roll", "pitch", "yaw")},
        "total_angle_deg": round(math.degrees(path_angle_rad), PLACES),
    }


def pin_of_reference(path: Path) -> tuple[Pin | None, tuple[str, ...]]:
    """Return the pin in the provenance of a reference, and the names of its case and log."""
    with suppress(QuatpropError, LookupError, TypeError, ValueError, AttributeError):
        provenance = provenance_of(str(path))
        check, result = provenance[PROVENANCE_KEY], provenance["result"]
        entry = {key: check[key] for key in ("inputs", "options", "every")}
        entry |= {"quatprop": provenance["quatprop"], "reference": sha256_of(str(path))}
        entry |= {"samples": result["samples"], "span_s": result["span_s"]}
        entry |= _angles(np.array(result["final_wxyz"], float), result["path_angle_rad"])
        pin = pin_of({**entry, "remarks": [], "measured": {}})
        return pin, (str(check["case"]), str(provenance["source"]["path"]))
    return None, ()


def _significant(value: float) -> float:
    return float(f"{value:.6g}")


def change_lines(case: Case, old: Pin, new: Pin, run: CaseRun) -> list[str]:
    """Return the differences between two pins, except references and remarks."""
    lines = [
        f"{key}: SHA-256 {(before or 'none')[:DIGITS]} -> {(after or 'none')[:DIGITS]}"
        for key, before, after in differences(old.inputs, new.inputs)
    ]
    lines += [
        f"{key}: {option_text(before)} -> {option_text(after)}"
        for key, before, after in option_differences(old, case)
    ]
    if old.quatprop != new.quatprop:
        lines.append(f"quatprop: {old.quatprop} -> {new.quatprop}")
    if old.samples != new.samples:
        lines.append(f"samples: {old.samples} -> {new.samples}")
    total_angles = f"{old.total_angle_deg:.9g} deg -> {new.total_angle_deg:.9g} deg"
    if old.final_deg != new.final_deg or old.total_angle_deg != new.total_angle_deg:
        # Rounded like the angles of a lock.
        apart = degrees_text(round(final_distance(old, run.report.result.final_wxyz), 8))
        lines.append(f"final attitude: {apart} from the one pinned; total angle: {total_angles}")
    for name in ("max", "rms", "final"):
        old_error, new_error = old.measured.get(name), new.measured.get(name)
        if old_error != new_error and new_error is not None:
            old_text = "none" if old_error is None else f"{old_error} deg"
            lines.append(f"{name} error: {old_text} -> {new_error} deg")
    return lines


def final_distance(pin: Pin, final_wxyz: Float64) -> float:
    """Return the angle between the pinned attitude at the last sample and another, rad.

    Near a pitch of 90 deg the differences of roll and yaw do not show the distance.
    """
    angles = np.radians([[pin.final_deg[name] for name in ("yaw", "pitch", "roll")]])
    return float(geodesic_angle(from_euler("zyx", angles)[0], final_wxyz))
