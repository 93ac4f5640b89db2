"""Stored references: small Parquet files with their provenance."""

from __future__ import annotations

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
from quatprop.text import Setting, plain, quoted
from quatprop.writers import open_writer

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from quatprop.check.case_run import CaseRun

PROVENANCE_KEY = "check"
"""Key of the provenance that only stored references have."""

CONVENTION_KEYS = ("product", "attitude")
"""Entries of the convention that are the same in every reference."""

DEFAULT = "the default"
"""How an option that is not set is shown."""

MAX_ROWS = 1000
"""Most attitudes in a reference, unless the case itself chooses them."""

LEAST_ROWS = 10
"""Fewest attitudes in a reference of a log that has as many."""


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
    """Return the attitude at the last sample of a stored reference, wxyz; None if not known."""
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
    """Return JSON with the paths of inputs as the suite has them."""
    if isinstance(value, dict):
        return {names.get(key, key): _with_names(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_names(item, names) for item in value]
    return names.get(value, value) if isinstance(value, str) else value


def refuse_thin(case: Case, run: CaseRun) -> None:
    """Refuse a reference of so few attitudes of a log that a change would not be seen."""
    count, t_ns = len(run.series), run.series.t_ns
    covered = float(t_ns.max() - t_ns.min()) * 1e-9 if count else 0.0
    if count >= min(LEAST_ROWS, run.samples) and 2 * covered >= run.report.result.span_s:
        return
    keys = " or ".join(key for key in ("every", "rate", "at") if key in case.options)
    raise OutputError(
        str(case.reference),
        f"a reference of {count} of {run.samples} attitudes, over {covered:.6g} s of "
        f"{run.report.result.span_s:.6g} s, would pass nearly any change; choose at least "
        f"{LEAST_ROWS} over half of the log with {keys or 'another log'}",
    )


def refuse_replacing(target: Path) -> None:
    """Refuse to replace a file that is no stored reference.

    A stored reference can be made again; an independent series under this name may be the only
    copy.
    """
    with suppress(QuatpropError):
        if not target.exists() or PROVENANCE_KEY in _provenance(str(target)):
            return
    raise OutputError(
        target,
        f"this was not written by check {Setting('update')}, which would replace it; move it "
        "away, or name an independent series as reference-log",
    )


def describe_provenance(case: Case, pin: Pin) -> str:
    """Return how the provenance of a file that is not the pinned reference differs."""
    try:
        provenance = _provenance(str(case.reference))
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


def _provenance(path: str) -> Mapping[str, Any]:
    return read_reference(path).signal.provenance


def orphaned_references(cases: Iterable[Case | CaseNotRun], deleted: Iterable[Pin]) -> list[Path]:
    """Return the stored references of deleted cases, in the folders of the other references."""
    digests = {pin.reference for pin in deleted}
    used = {Path(case.reference) for case in cases if isinstance(case, Case) and case.reference}
    return [
        path
        for folder in sorted({path.parent for path in used})
        for path in sorted(folder.glob("*.parquet"))
        if path not in used and digest_of(path).sha256 in digests
    ]
