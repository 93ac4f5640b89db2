"""Update a case: make its reference anew, and list what changes, with the angle."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from quatprop.check.case import Case, CaseResult
from quatprop.check.case_run import CaseRun, chooses_rows, distance_text, propagate_case
from quatprop.check.changes import change_lines
from quatprop.check.judge import result_of
from quatprop.check.lock import DIGITS, Pin, refuse_lfs_pointer, sha256_of
from quatprop.check.reference import decimation, refuse_replacing, write_reference
from quatprop.check.remarks import loss_notes
from quatprop.text import plain, quoted
from quatprop.version import __version__
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_outside, refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from quatprop.check.judge import Judgement


class Proposal(NamedTuple):
    """What an update of a case would do.

    `result`: the result with what would change, and what would be pinned
    `reference`: the new reference, to be put in its place; None where it stays
    """

    result: CaseResult
    reference: Path | None = None


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
    found, target, changes = judged.found, None, list[str]()
    if case.reference is None:
        failures = filter(None, [judged.comparison and judged.comparison.failure])
        result = result_of(case, judged.comparison, "", [*failures], lasting)
    else:
        run, every = _rerun(case, judged, folder)
        target = folder / "reference.parquet"
        write_reference(case, run, found.inputs, every, target)
        found = found._replace(every=every, reference=sha256_of(str(target)))
        written = f"{len(run.series)} of {run.samples} attitudes in {plain(case.reference)}"
        result = CaseResult(case.name, "pass", summary=written, notes=lasting)
        changes += _of_reference(case, pin, judged, found)
    if pin is not None:
        changes = [*change_lines(case, pin, found, judged.run), *changes]
    for name, former in deleted.items() if pin is None else ():
        if former.inputs.get("log", "") == found.inputs.get("log"):
            changes.append(f"pinned as {quoted(name)} before")
            changes += change_lines(case, former, found, judged.run)
    updated = "new" if pin is None and not changes else "updated" if changes else "kept"
    result = result._replace(updated=updated, changes=(*changes, *remarks))
    result = result._replace(remarks=tuple(judged.remarks.values()))
    return Proposal(result._replace(pin=found), target if updated != "kept" else None)


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


def _of_reference(case: Case, pin: Pin | None, judged: Judgement, found: Pin) -> Iterator[str]:
    """Yield how a new reference differs from the one that is there, or was."""
    path, new = str(case.reference), str(found.reference)
    if not Path(path).exists():
        if pin is not None:
            yield f"reference: missing -> SHA-256 {new[:DIGITS]}"
        return
    if (old := sha256_of(path)) == new:
        return
    yield f"reference: SHA-256 {old[:DIGITS]} -> {new[:DIGITS]}"
    if judged.reference is None:
        yield "attitudes: the old reference could not be read"
        return
    cause = judged.comparison.cause if judged.comparison else ""
    distance = distance_text(judged.run.series, judged.reference.series)
    yield f"attitudes: {distance}" + (f"; likely cause: {cause}" if cause else "")
