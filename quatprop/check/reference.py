"""Stored references: small Parquet files that say how they came about."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.errors import OutputError, QuatpropError
from quatprop.pipeline.report import CONVENTION
from quatprop.signals.compared_series import Reading, read_operand
from quatprop.text import plain, quoted
from quatprop.writers import open_writer

if TYPE_CHECKING:
    from quatprop.check.case import Case
    from quatprop.check.lock import Pin
    from quatprop.check.measure import Measured
    from quatprop.signals.compared_series import Operand

MARK = "check"
"""Key of the provenance that makes a file a stored reference."""

SHARED = ("product", "attitude")
"""What every reference has to say of its convention, in the same words."""

NOT_SAID = "the default"
"""What an option is where nothing is said."""

ROWS = 1000
"""At most so many attitudes are kept, where the case does not say which."""


def thinning(samples: int) -> int:
    """Return which so-manieth attitude to keep of a log: 1, 2, 5, 10, 20, 50...

    Round steps, so that a few samples more or less do not ask for other ones.

    Examples
    --------
    >>> [thinning(samples) for samples in (0, 1000, 1001, 5580, 1_000_000)]
    [1, 1, 2, 10, 1000]
    """
    decade = 1
    while True:
        for step in (decade, 2 * decade, 5 * decade):
            if samples <= ROWS * step:
                return step
        decade *= 10


def read_reference(path: str) -> Operand:
    """Read a stored reference."""
    return read_operand(Reading(path, "parquet"))


def write_reference(case: Case, now: Measured, hashes: dict[str, str], every: int | None) -> None:
    """Write the reference of a case, with its provenance.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    target = Path(str(case.reference))
    report = {key: value for key, value in now.report.items() if key != "timings"}
    # What is kept must not depend on where it was made.
    report["source"] = {**report["source"], "path": Path(case.job.log).name}
    if "q0" in hashes:
        report["convention"] = {**report["convention"], "q0_from": case.options["q0"]}
    report[MARK] = {
        "case": case.name,
        "options": case.options,
        "every": every,
        "inputs": hashes,
    }
    target.parent.mkdir(parents=True, exist_ok=True)
    with open_writer(target, "parquet", layout="scalar-first") as writer:
        writer.write(now.series)
        writer.commit(report)


def refuse_foreign(target: Path) -> None:
    """Refuse to replace a file that no update has written.

    An external series under this name is somebody's only copy; what --update writes can be
    written again.

    Raises
    ------
    OutputError
        It is something else.
    """
    if not target.exists():
        return
    try:
        known = MARK in _provenance(str(target))
    except QuatpropError:
        known = False
    if not known:
        raise OutputError(
            target,
            "this was not written by check --update, which would replace it; move it away, or "
            "say reference-log for a series from elsewhere",
        )


def differing_provenance(case: Case, pin: Pin) -> str:
    """Say what a file that is not the pinned reference tells of itself, and should not."""
    try:
        told = _provenance(str(case.reference))
    except QuatpropError:
        return ", and cannot be read"
    if MARK not in told:
        return ", and was not written by check --update"
    made = told[MARK]
    facts: list[tuple[str, Any, Any]] = [("quatprop", told.get("quatprop"), pin.quatprop)]
    facts += [(key, (told.get("convention") or {}).get(key), CONVENTION[key]) for key in SHARED]
    facts += [("case", made.get("case"), case.name), ("every", made.get("every"), pin.every)]
    options = made.get("options") or {}
    facts += [
        (key, options.get(key, NOT_SAID), case.options.get(key, NOT_SAID))
        for key in sorted(options.keys() | case.options.keys())
    ]
    words = [
        f"{plain(key)} {quoted(is_)} instead of {quoted(wanted)}"
        for key, is_, wanted in facts
        if is_ != wanted
    ]
    return f", and says of itself: {', '.join(words)}" if words else ""


def _provenance(path: str) -> dict[str, Any]:
    return read_reference(path).source.provenance
