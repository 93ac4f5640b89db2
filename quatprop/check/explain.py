"""What a case depends on, what of it is pinned, and how it is judged, in lines of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.check.case import CaseNotRun
from quatprop.check.case_run import angle_text
from quatprop.check.judge import differences
from quatprop.check.lock import DIGITS, digests_of
from quatprop.check.spelling import sentence
from quatprop.comparison.settings import Sigmas
from quatprop.errors import QuatpropError
from quatprop.text import listed, plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from quatprop.check.case import Case
    from quatprop.check.lock import Pin


def explain(case: Case | CaseNotRun, pin: Pin | None) -> str:
    """Return what a case depends on, what is pinned, and how it is judged.

    Parameters
    ----------
    case
        The case.
    pin
        What the lock has of it; None if nothing.
    """
    lines = [f"{plain(case.name)} (line {case.line} of the suite)"]
    facts = [("", plain(case.reason))] if isinstance(case, CaseNotRun) else _facts(case, pin)
    return "\n".join([*lines, *(f"  {name:<10} {text}".rstrip() for name, text in facts)])


def _facts(case: Case, pin: Pin | None) -> Iterator[tuple[str, str]]:
    for key, path in case.inputs.items():
        pinned = {
            name.partition("/")[2]: digest
            for name, digest in (pin.inputs.items() if pin else ())
            if name.partition("/")[0] == key
        }
        yield key, f"{plain(path)}: {_state(path, pinned) if pinned else 'not pinned'}"
    options = {**(pin.options if pin else {}), **case.options}
    for key in sorted(options):
        was, now = (pin.options.get(key) if pin else None), case.options.get(key)
        change = "" if was == now or pin is None else f", pinned as {plain(was or 'the default')}"
        yield key, f"{plain(now or 'the default')}{change}"
    if case.reference is not None:
        state = (
            _state(case.reference, {"": pin.reference}) if pin and pin.reference else "not pinned"
        )
        yield "reference", f"{plain(case.reference)}: {state}"
    elif case.external is not None:
        yield "reference", f"{plain(case.external.path)}, an independent series"
    comparison = case.comparison
    if (tolerance := comparison.tol) is not None:
        limit = str(tolerance)
        if not isinstance(tolerance, Sigmas):
            limit = angle_text(tolerance, in_degrees=case.in_degrees)
        yield "judged by", f"worst error of at most {limit}, alignment {comparison.align}"
    if case.external is None:
        yield "", "equal timestamps" if case.strict else "timestamps may differ"
    if pin is not None and (case.strict or case.pins_log):
        yield "", f"{pin.samples} samples"
    if case.xfail:
        yield "xfail", plain(case.xfail)
    if pin is None:
        yield "lock", "no entry"
        return
    every = f", every {pin.every}th attitude" if pin.every and pin.every > 1 else ""
    yield "lock", f"by quatprop {pin.quatprop}{every}"


def _state(path: str, pinned: Mapping[str, str]) -> str:
    """Return how the files of a path, by name, are as they were pinned."""
    try:
        digests = digests_of(path)
    except QuatpropError as error:
        return sentence(error).removeprefix(f"{plain(path)}: ")
    changed = [name for name, *_ in differences(pinned, digests)]
    if set(digests) != {""}:
        is_same = f"{len(digests)} files, as pinned"
        return f"changed: {listed(map(plain, changed))}" if changed else is_same
    digest, was = digests[""], pinned.get("", "")
    if not changed:
        return f"SHA-256 {was[:DIGITS]}, as pinned"
    return f"changed: SHA-256 {digest[:DIGITS]}, pinned {was[:DIGITS]}"
