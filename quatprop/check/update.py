"""Update a case: make its reference anew, and list what changes, with the angle."""

from __future__ import annotations

import shlex
from difflib import SequenceMatcher
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from quatprop.check.case import Case, CaseNotRun, CaseResult
from quatprop.check.case_run import (
    CaseRun,
    chooses_rows,
    compare_case,
    distance_text,
    propagate_all,
    propagate_case,
)
from quatprop.check.changes import change_lines, pin_of_reference
from quatprop.check.judge import result_of
from quatprop.check.lock import DIGITS, Pin, refuse_lfs_pointer, sha256_of, with_content
from quatprop.check.reference import (
    REFERENCES,
    decimation,
    read_reference,
    refuse_replacing,
    stray_references,
    thin,
    write_reference,
)
from quatprop.check.remarks import loss_notes
from quatprop.errors import QuatpropError
from quatprop.provenance import digest_of
from quatprop.text import Setting, plain, quoted, spelled
from quatprop.version import __version__
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_outside, refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.check.judge import Judgement

LEAST_COVERED = 50.0
"""Percentage of the old reference with which the new attitudes must be compared."""


class Former(NamedTuple):
    """What was pinned, or is told by a reference, and may be a new case under another name.

    `names`: of the case, and of the log where that is known
    `label`: how it is named before what changes; empty where it is the case itself
    `way_out`: what to do where a new case is another one
    `is_pinned`: whether the lock has it
    """

    pin: Pin
    names: tuple[str, ...] = ()
    label: str = ""
    way_out: str = ""
    is_pinned: bool = False


def former_cases(
    suite: Path, cases: Sequence[Case | CaseNotRun], pins: Mapping[str, Pin]
) -> Iterator[Former]:
    """Yield what new cases may be, renamed: the pins and references that the suite has no more."""
    names = {case.name for case in cases}
    told: dict[str | None, tuple[str, ...]] = {}
    pinned = {pin.reference for pin in pins.values()}
    for path in [] if names <= pins.keys() else stray_references(suite.parent, cases):
        pin, names_of = pin_of_reference(path)
        if pin is not None and pin.reference in pinned:
            told[pin.reference] = names_of
        elif pin is not None:
            label = f"compared with {plain(path)}, which no case has"
            yield Former(pin, names_of, label, "remove that file first")
    for name in [name for name in pins if name not in names]:
        label = f"compared with {quoted(name)}, which is pinned, but not in the suite"
        way_out = f"{Setting('update')} -k {shlex.quote(plain(name))}"
        way_out = f"remove that from the lock first, with {way_out}"
        known = (name, *told.get(pins[name].reference, ()))
        yield Former(pins[name], known, label, way_out, is_pinned=True)


class Proposal(NamedTuple):
    """What an update of a case would do.

    `result`: the result with what would change, and what would be pinned
    `reference`: the new reference, to be put in its place; None where it stays
    `unknown`: why nobody knows how far the attitudes have changed; empty where that is listed
    """

    result: CaseResult
    reference: Path | None = None
    unknown: str = ""


def refuse_target(case: Case, pin: Pin | None, folder: Path) -> None:
    """Refuse a case whose reference an update must not write."""
    if case.reference is not None:
        refuse_outside(case.reference, folder)
        refuse_overlap(case.inputs.values(), [case.reference])
        refuse_lfs_pointer(case.reference)
        if pin is None or pin.reference is None:
            refuse_replacing(Path(case.reference))


def propose(
    case: Case, pin: Pin | None, judged: Judgement, folder: Path, former: Sequence[Former]
) -> Proposal:
    """Return what an update of a case that was judged would do.

    A case that passes keeps its reference: references that moved a little at every update would
    drift. It was found to be what this version gives, too.

    `folder`: takes the new reference until it is accepted
    `former`: what the suite has no more, and was pinned: a new case may be that, renamed
    """
    lasting = tuple(loss_notes(case, judged.run, judged.reference))
    remarks = tuple(
        f"remark: {text}"
        for code, text in judged.remarks.items()
        if (pin is None or code not in pin.remarks) and text not in lasting
    )
    if pin is not None and judged.result.verdict == "pass":
        kept = pin._replace(quatprop=__version__, remarks=judged.found.remarks)
        result = judged.result._replace(notes=lasting, unpinned=(), changes=remarks)
        return Proposal(result._replace(updated="kept", pin=kept))
    found, target, changes, unknown = judged.found, None, list[str](), ""
    there = digest_of(case.reference).sha256 if case.reference else None
    before = [Former(pin)] if pin else _former(case, found, former, there)
    if case.reference is None:
        failures = filter(None, [judged.comparison and judged.comparison.failure])
        result = result_of(case, judged.comparison, "", [*failures], lasting)
    else:
        run, every = _rerun(case, judged, folder)
        if reason := thin(case, run.series, run.samples, run.report.result.span_s):
            raise QuatpropError(reason)
        # What cannot be aligned even with itself would never pass.
        fits = case.comparison.align == "none" and case.comparison.time_offset != "auto"
        if not fits and (reason := compare_case(case, run.series, run.series).impossible):
            raise QuatpropError(reason)
        target = folder / "reference.parquet"
        write_reference(case, run, found.inputs, every, target)
        found = found._replace(every=every, reference=sha256_of(str(target)))
        written = f"{len(run.series)} of {run.samples} attitudes in {plain(case.reference)}"
        result = CaseResult(case.name, "pass", summary=written, notes=lasting)
    for one in before:
        changes += [*filter(None, [one.label]), *change_lines(case, one.pin, found, judged.run)]
        unchanged = pin is not None and pin.reference == found.reference == there
        if case.reference is not None and not unchanged:
            lines, why = _of_reference(case, one, judged, found, folder)
            changes, unknown = [*changes, *lines], unknown or why
    updated = "updated" if changes else "kept" if before else "new"
    result = result._replace(updated=updated, changes=(*changes, *remarks))
    result = result._replace(remarks=tuple(judged.remarks.values()))
    return Proposal(result._replace(pin=found), target if updated != "kept" else None, unknown)


def put_in_place(case: Case, proposal: Proposal) -> None:
    """Replace the reference of a case by the one that was proposed."""
    if proposal.reference is not None:
        target = Path(str(case.reference))
        target.parent.mkdir(parents=True, exist_ok=True)
        with open_atomic(target) as stream:
            stream.write(proposal.reference.read_bytes())


def _rerun(case: Case, judged: Judgement, folder: Path) -> tuple[CaseRun, int | None]:
    """Return the run of a case with at most as many attitudes as a reference has, and N."""
    if chooses_rows(case):
        return judged.run, None
    # The number of samples is known only after the run.
    every = decimation(judged.run.samples)
    as_judged = every == (judged.run.every or 1)
    return (judged.run if as_judged else propagate_case(case, every, folder)), every


def _former(case: Case, found: Pin, former: Sequence[Former], there: str | None) -> list[Former]:
    """Return with what a new case is compared: what it most likely was, and what it replaces.

    What has neither its log nor a name in common may be any of those that are pinned.

    `there`: SHA-256 of the file that is where its reference goes
    """
    names = {case.name, Path(case.log).name}

    def likeness(one: Former) -> tuple[bool, bool, bool, float]:
        old = one.pin
        same_log = old.inputs.get("log", "") == found.inputs.get("log")
        same_name = SequenceMatcher(None, one.names[0], case.name).ratio()
        return same_log, bool(names & {*one.names}), old.options == found.options, same_name

    like = [one for one in former if any(likeness(one)[:2])]
    chosen = [max(like, key=likeness)] if like else [one for one in former if one.is_pinned]
    if there is not None and all(one.pin.reference != there for one in chosen):
        told = pin_of_reference(Path(str(case.reference)))[0] or found
        chosen.append(Former(told._replace(reference=there)))
    return chosen


def _of_reference(
    case: Case, before: Former, judged: Judgement, found: Pin, folder: Path
) -> tuple[list[str], str]:
    """Return how a new reference differs from the old one, and why that is not known, if it is not.

    `before`: the case as it was pinned, or what it was before it was renamed
    """
    path, new, pinned = Path(str(case.reference)), str(found.reference), before.pin.reference
    there = digest_of(path).sha256
    was = there if there != new else pinned
    was_text = f"SHA-256 {was[:DIGITS]}" if was else "missing"
    lines = [f"reference: {was_text} -> SHA-256 {new[:DIGITS]}"]
    if pinned == new and there is None:
        return lines, ""
    run, old = judged.run, judged.reference
    if pinned not in {there, new}:
        suite = Path(case.suite).parent
        moved = with_content(suite, REFERENCES, pinned) if pinned else None
        old = read_reference(str(moved)) if moved else None
    if old is None:
        why = "could not be read" if pinned == there else "is gone"
        old_one = f"the old reference {why}" if pinned else "no reference was stored before"
        distance, share = f"not comparable: {old_one}", 0.0
    else:
        if chooses_rows(case) or pinned not in {there, new}:
            # Of fewer attitudes than there were, the largest change is not the largest.
            run = propagate_all(case, folder)
        distance, share = distance_text(run.series, old.series)
    cause = judged.comparison.cause if judged.comparison else ""
    lines.append(f"attitudes: {distance}" + (f"; likely cause: {cause}" if cause else ""))
    if share >= LEAST_COVERED:
        return lines, ""
    way_out = (
        f"restore the old one, or accept it unseen with {Setting('update')} {Setting('force')}"
    )
    if before.way_out:
        way_out += f"; if this is another case, {before.way_out}"
    return lines, spelled(
        f"{plain(path)}: the largest change of the attitudes cannot be measured: {distance}; "
        f"{way_out}"
    )
