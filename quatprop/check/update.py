"""Update a case: make its reference anew, and list what changes, with the angle."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from quatprop.check.case import Case, CaseResult
from quatprop.check.case_run import (
    CaseRun,
    chooses_rows,
    distance_text,
    propagate_all,
    propagate_case,
)
from quatprop.check.changes import change_lines
from quatprop.check.judge import result_of
from quatprop.check.lock import DIGITS, Pin, refuse_lfs_pointer, sha256_of, with_content
from quatprop.check.reference import (
    decimation,
    read_reference,
    refuse_replacing,
    refuse_thin,
    write_reference,
)
from quatprop.check.remarks import loss_notes
from quatprop.text import Setting, plain, quoted, spelled
from quatprop.version import __version__
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_outside, refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.check.judge import Judgement

LEAST_COVERED = 50.0
"""Percentage of the old reference with which the new attitudes must be compared."""


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
    case: Case, pin: Pin | None, judged: Judgement, folder: Path, deleted: Mapping[str, Pin]
) -> Proposal:
    """Return what an update of a case that was judged would do.

    A case that passes keeps its reference: references that moved a little at every update would
    drift. It was found to be what this version gives, too.

    `folder`: takes the new reference until it is accepted
    `deleted`: pins of cases that the suite has no more: a new case may be one of them, renamed
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
    log = found.inputs.get("log")
    former = {name: old for name, old in deleted.items() if old.inputs.get("log", "") == log}
    if pin is not None:
        former = {}
    if case.reference is None:
        failures = filter(None, [judged.comparison and judged.comparison.failure])
        result = result_of(case, judged.comparison, "", [*failures], lasting)
    else:
        run, every = _rerun(case, judged, folder)
        refuse_thin(case, run)
        target = folder / "reference.parquet"
        write_reference(case, run, found.inputs, every, target)
        found = found._replace(every=every, reference=sha256_of(str(target)))
        written = f"{len(run.series)} of {run.samples} attitudes in {plain(case.reference)}"
        result = CaseResult(case.name, "pass", summary=written, notes=lasting)
        before = pin or next(iter(former.values()), None)
        changes, unknown = _of_reference(case, before, judged, found, folder)
    if pin is not None:
        changes = [*change_lines(case, pin, found, judged.run), *changes]
    for name, old in former.items():
        lines = change_lines(case, old, found, judged.run)
        changes = [*changes, f"pinned as {quoted(name)} before", *lines]
    updated = "new" if pin is None and not changes else "updated" if changes else "kept"
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


def _of_reference(
    case: Case, before: Pin | None, judged: Judgement, found: Pin, folder: Path
) -> tuple[list[str], str]:
    """Return how a new reference differs from the old one, and why that is not known, if it is not.

    `before`: the pin of the case, or of the one that it was before it was renamed
    """
    path, new = Path(str(case.reference)), str(found.reference)
    there = sha256_of(str(path)) if path.exists() else None
    pinned = before.reference if before else there
    if pinned == new == there or (before is None and there is None):
        return [], ""
    was = there if there != new else pinned
    was_text = f"SHA-256 {was[:DIGITS]}" if was else "missing"
    lines = [f"reference: {was_text} -> SHA-256 {new[:DIGITS]}"]
    if pinned == new and there is None:
        return lines, ""
    run, old = judged.run, judged.reference
    if pinned not in {there, new}:
        suite = Path(case.suite).parent
        moved = with_content(suite, "**/*.p[aq]*", pinned) if pinned else None
        old = read_reference(str(moved)) if moved else None
    if old is None:
        why = "could not be read" if pinned == there else "is gone"
        distance, share = f"not comparable: the old reference {why}", 0.0
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
    return lines, spelled(
        f"{plain(path)}: the largest change of the attitudes cannot be measured: {distance}; "
        f"{way_out}"
    )
