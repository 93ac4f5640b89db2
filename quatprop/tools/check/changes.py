"""Differences between a case and its pin: inputs, options, reference, results."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from dataclasses import replace
from glob import escape
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.base import __version__
from quatprop.base.errors import OutputError, QuatpropError, UnreadableLogError
from quatprop.base.provenance import digest_of
from quatprop.base.rendering import count_text, degrees_text
from quatprop.base.text import Setting, listed, plain, quoted, spelled, spelling
from quatprop.kinematics.conventions import euler_angles
from quatprop.propagation.attitude_input import AttitudeInput, LoadedAttitudes, load_attitudes
from quatprop.propagation.report import CONVENTION
from quatprop.settings import in_keys, suite_key
from quatprop.settings.command_options import Sigmas
from quatprop.tools.check.case import SHOWN_DEG, Case, CaseNotRun, is_log, largest_errors
from quatprop.tools.check.cases import CRITERIA, LIMITS, same_option
from quatprop.tools.check.lock import (
    DIGITS,
    FRAMES,
    Pin,
    describe_change,
    digests_of,
    pin_of,
    sha256_of,
    with_content,
)
from quatprop.tools.check.pinned_numbers import final_apart_deg, moved_deg
from quatprop.writers import open_writer

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from quatprop.base.arrays import Float64
    from quatprop.kinematics.series import AttitudeSeries
    from quatprop.tools.check.case import CaseComparison, CaseRun


# Stored references: small Parquet files with their provenance.


REFERENCES = "**/*.[pP][aAqQ]*"
"""Glob pattern for references in and below the folder of a suite."""

MAX_FOOTER = 1 << 20
"""Bytes at the end of a Parquet file that are searched for its provenance."""

PROVENANCE_KEY = "check"
"""Key of the provenance that only stored references have."""

CONVENTION_KEYS = ("product", "attitude")
"""Entries of the convention that are equal in all references."""

DEFAULT = "the default"
"""Text for an option that is not set."""

MAX_ROWS = 1000
"""Most attitudes in a reference, unless the case has settings for that."""

LEAST_ROWS = 10
"""Fewest attitudes in a reference, unless the log has fewer samples."""


def decimation(samples: int) -> int:
    """Return N, where a reference keeps every N-th attitude of a log: 1, 2, 5, 10, 20, 50...

    The steps are round, so that a few samples more or less do not change N.
    """
    steps = (step * int(10**power) for power in count() for step in (1, 2, 5))
    return next(step for step in steps if samples <= MAX_ROWS * step)


def read_reference(path: str) -> LoadedAttitudes:
    """Read a stored reference."""
    return load_attitudes(AttitudeInput(path, "parquet"))


def final_of(reference: LoadedAttitudes) -> Any:
    """Return the attitude at the last sample, wxyz, from the provenance; None if unknown."""
    return reference.signal.provenance.get("result", {}).get("final_wxyz")


def write_reference(
    case: Case, run: CaseRun, hashes: Mapping[str, str], every: int | None, target: Path
) -> None:
    """Write the reference of a case, with its provenance, to a file."""
    # The content must not depend on the folder in which it was made.
    names = {path: case.options.get(key, Path(path).name) for key, path in case.inputs.items()}
    names[" + ".join(case.logs)] = " + ".join(names[path] for path in case.logs)
    report = _with_names(replace(run.report, seconds=None).as_json(), names)
    report[PROVENANCE_KEY] = {
        "case": case.name,
        "options": dict(case.options),
        "every": every,
        "inputs": dict(hashes),
    }
    with open_writer(target, "parquet", layout="scalar-first") as writer:
        writer.write(run.series)
        writer.commit(report)


def _with_names(value: Any, names: Mapping[str, str]) -> Any:
    """Replace paths in JSON by their names in the suite."""
    if isinstance(value, dict):
        return {names.get(key, key): _with_names(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_names(item, names) for item in value]
    return names.get(value, value) if isinstance(value, str) else value


def too_sparse(case: Case, series: AttitudeSeries, samples: int, span_s: float) -> str:
    """Return an error if a reference has too few attitudes to detect a change; else ``""``.

    `samples`, `span_s`: number of samples and length of the log, s
    """
    count, t_ns = len(series), series.t_ns
    covered = float(t_ns.max() - t_ns.min()) * 1e-9 if count else 0.0
    if count >= min(LEAST_ROWS, samples) and 2 * covered >= span_s:
        return ""
    keys = " or ".join(key for key in ("every", "rate", "at") if key in case.options)
    return spelled(
        f"{plain(case.reference)}: a reference of {count} of {samples} attitudes, over "
        f"{covered:.6g} s of {span_s:.6g} s, would pass nearly any change; choose at least "
        f"{LEAST_ROWS} over half of the log with {keys or 'another log'}, and write it with "
        f"{Setting('update')}"
    )


def refuse_replacing(target: Path) -> None:
    """Refuse to replace a file that is not a stored reference.

    A stored reference can be made again; this file may be the only copy of an independent series.
    """
    with suppress(QuatpropError):
        if not target.exists() or PROVENANCE_KEY in provenance_of(str(target)):
            return
    raise OutputError(
        target,
        f"this was not written by check {Setting('update')}, which would replace it; move it "
        "away, or name an independent series as reference-log",
    )


def describe_provenance(case: Case, pin: Pin) -> str:
    """Return how the provenance of a changed reference file differs from the pin."""
    try:
        provenance = provenance_of(str(case.reference))
    except QuatpropError:
        return ", and cannot be read"
    if PROVENANCE_KEY not in provenance:
        return ", and was not written by quatprop check"
    check = provenance[PROVENANCE_KEY]
    convention, options = provenance.get("convention") or {}, check.get("options") or {}
    facts: list[tuple[str, object, object]] = [
        ("quatprop", provenance.get("quatprop"), pin.quatprop),
        *((key, convention.get(key), CONVENTION[key]) for key in CONVENTION_KEYS),
        ("case", check.get("case"), case.name),
        ("every", check.get("every"), pin.every),
    ]
    facts += [
        (key, options.get(key, DEFAULT), case.options.get(key, DEFAULT))
        for key in sorted(options.keys() | case.options.keys())
    ]
    facts += [
        (f"{key} of SHA-256", str(digest)[:DIGITS], pin.inputs[key][:DIGITS])
        for key, digest in sorted((check.get("inputs") or {}).items())
        if key in pin.inputs
    ]
    differences = ", ".join(
        f"{plain(key)} {quoted(actual)} instead of {quoted(expected)}"
        for key, actual, expected in facts
        if actual != expected
    )
    return f"; its metadata have {differences}" if differences else ""


def provenance_of(path: str) -> Mapping[str, Any]:
    """Return the provenance of a stored reference."""
    return read_reference(path).signal.provenance


def stray_references(folder: Path, cases: Iterable[Case | CaseNotRun]) -> Iterator[Path]:
    """Yield the stored references below a folder that belong to no case."""
    valid = [case for case in cases if isinstance(case, Case)]
    used = {
        os.path.realpath(path) for case in valid for path in (case.reference, *case.logs) if path
    }
    for path in sorted(folder.glob(REFERENCES)):
        with suppress(OSError), path.open("rb") as stream:
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - MAX_FOOTER))
            if os.path.realpath(path) not in used and PROVENANCE_KEY.encode() in stream.read():
                yield path


def orphaned_references(
    folder: Path, cases: Iterable[Case | CaseNotRun], deleted: Iterable[Pin]
) -> list[Path]:
    """Return the stored references of deleted cases."""
    digests = {pin.reference for pin in deleted}
    strays = stray_references(folder, cases) if digests else ()
    return [path for path in strays if digest_of(path).sha256 in digests]


PLACES = 6
"""Decimals of the angles in a lock, deg."""

WXYZ_PLACES = 8
"""Decimals of the quaternions in a lock."""


def hash_inputs(case: Case, pin: Pin | None) -> dict[str, str]:
    """Return the SHA-256 of every pinned input, by key of the suite.

    In a folder each file that is read has its own, by key and name: ``log/metadata.yaml``.
    """
    hashes = {}
    for key, path in case.inputs.items():
        if not case.pins_log and is_log(key):
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


def pin_mismatches(case: Case, pin: Pin | None, hashes: Mapping[str, str]) -> str:
    """Return the differences from the pin that prevent a verdict, and the remedy, or ``""``."""
    differing = [*_pin_mismatches(case, pin, hashes)]
    if not differing:
        return ""
    sentences, remedies = zip(*differing, strict=True)
    return spelled("; ".join([*sentences, remedies[-1] + Setting("update")]))


def _pin_mismatches(
    case: Case, pin: Pin | None, hashes: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    """Yield each difference from the pin, with its file, and the remedy before "update"."""
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
    logs = {*filter(is_log, others)}
    if "log" in logs:
        changed.append(f"pin-log was {not case.pins_log} and is now {case.pins_log}".lower())
    elif logs:
        counts = (count_text(sum(map(is_log, keys)), "file") for keys in (before, after))
        changed.append("its log was {} and is now {}".format(*counts))
    if changed:
        yield f"{about}: the case has changed since it was pinned: {', '.join(changed)}", accept
    if others - logs or (pin.reference is None) != (case.reference is None):
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
        alignment=_fitted(case, comparison),
    )


def _fitted(case: Case, comparison: CaseComparison | None) -> dict[str, tuple[float, ...]]:
    """Return the rotations that align an independent series, wxyz, by the frame that they turn."""
    if case.external is None or comparison is None or comparison.result is None:
        return {}
    found = comparison.result.alignment
    frames = {"reference": found.reference_wxyz} if found.name != "none" else {}
    frames |= {"body": found.mount_wxyz} if found.name == "mount" else {}
    return {
        frame: tuple(float(part) for part in np.round(wxyz, WXYZ_PLACES) + 0.0)
        for frame, wxyz in frames.items()
    }


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
        pin = pin_of({**entry, "remarks": [], "measured": {}, "alignment": {}})
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
        final = final_apart_deg(old, run.report.result.final_wxyz)
        apart = degrees_text(round(math.radians(final), 8))
        lines.append(f"final attitude: {apart} from the one pinned; total angle: {total_angles}")
    for name in ("max", "rms", "final"):
        old_error, new_error = old.measured.get(name), new.measured.get(name)
        if old_error != new_error and new_error is not None:
            old_text = "none" if old_error is None else f"{old_error} deg"
            align = case.comparison.align
            aligned = "" if align == "none" else f", aligned by {align}"
            lines.append(f"{name} error: {old_text} -> {new_error} deg{aligned}")
    for frame in FRAMES:
        turned = moved_deg(old.alignment.get(frame), new.alignment.get(frame))
        if turned > SHOWN_DEG:
            lines.append(f"{frame} frame of the reference: rotated by {turned:.6g} deg")
    return lines


# Explain a case without running it: its inputs, its pin, and how it is judged.


@spelling(in_keys)
def explain(case: Case | CaseNotRun, pin: Pin | None) -> str:
    """Return the inputs of a case, its pin, and how it is judged, as text.

    `pin`: None if the lock has no entry for the case
    """
    lines = [f"{plain(case.name)} (line {case.line} of the suite)"]
    facts = [("", plain(case.reason))] if isinstance(case, CaseNotRun) else [*_facts(case, pin)]
    width = max(10, *(len(name) for name, _ in facts))
    return "\n".join([*lines, *(f"  {name:<{width}} {text}".rstrip() for name, text in facts)])


def is_usable(case: Case | CaseNotRun) -> bool:
    """Return whether a case can be run: it is valid, and its files exist."""
    if isinstance(case, CaseNotRun):
        return case.verdict != "error"
    files = [*case.inputs.values(), *filter(None, [case.reference])]
    return all(Path(file).exists() for file in files)


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
    if case.expect is not None:
        yield "expected", ", ".join(suite_key(name) for name in case.expect.given)
    if case.is_gate:
        return
    yield "judged by", f"alignment {case.comparison.align}"
    for key in sorted(CRITERIA & case.comparison_options.keys()):
        measured = pin.measured.get(key) if pin else None
        limit = f"{key} {plain(case.comparison_options[key])}"
        yield "", limit if measured is None else f"{limit}: {_margin(case, key, measured)}"
    if case.external is None:
        yield "", "equal timestamps" if case.strict else "timestamps may differ"
    if pin is not None and case.pins_log:
        yield "", f"{pin.samples} samples"
    if case.xfail:
        yield "xfail", plain(case.xfail)
    if pin is None:
        yield "lock", "no entry"
        return
    every = f", one of every {pin.every} attitudes" if pin.every and pin.every > 1 else ""
    yield "lock", f"by quatprop {pin.quatprop}{every}"
    for code in pin.remarks:
        yield "remark", plain(code)


def _margin(case: Case, key: str, measured: float) -> str:
    """Return the value measured when a case was pinned, and its margin below the limit."""
    limit = getattr(case.comparison, key.replace("-", "_"))
    if isinstance(limit, Sigmas):
        unit, maximum = "sigma", limit.count
    elif key in LIMITS:
        unit, maximum = "deg", math.degrees(limit)
    else:
        unit, maximum = "deg/h" if key == "drift-tol" else "%", limit
    text = f"{measured:g} {unit} when it was pinned"
    if not maximum or unit == "%":
        return text
    return f"{text}, margin {100 * (1 - abs(measured) / maximum):.0f} %"


def _state(path: str, pinned: Mapping[str, str]) -> str:
    """Return a path, and how its files, by name, differ from the pinned ones."""
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
