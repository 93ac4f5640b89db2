"""Explain a case without running it: its inputs, its pin, and how it is judged."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.check.case import Case, CaseNotRun
from quatprop.check.cases import CRITERIA, LIMITS
from quatprop.check.changes import differences
from quatprop.check.lock import DIGITS, Pin, digests_of
from quatprop.check.reference import DEFAULT
from quatprop.comparison.settings import Sigmas
from quatprop.errors import QuatpropError
from quatprop.settings.spelling import in_keys
from quatprop.text import listed, plain, spelling

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


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
    return f"{text}, {100 * (1 - abs(measured) / maximum):.0f} % left"


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
