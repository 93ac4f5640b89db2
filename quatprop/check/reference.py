"""Stored references: small Parquet files with their provenance."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.check.case import Case, CaseNotRun
from quatprop.check.lock import DIGITS, Pin
from quatprop.errors import OutputError, QuatpropError
from quatprop.logs.attitude_input import AttitudeInput, LoadedAttitudes, load_attitudes
from quatprop.pipeline.report import CONVENTION
from quatprop.provenance import digest_of
from quatprop.text import Setting, plain, quoted, spelled
from quatprop.writers import open_writer

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from quatprop.check.case_run import CaseRun
    from quatprop.series import AttitudeSeries

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
    used = {os.path.realpath(path) for case in valid for path in (case.reference, case.log) if path}
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
