"""Update a case: make a new reference, and list the changes, with their size."""

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
    too_sparse,
    write_reference,
)
from quatprop.check.remarks import loss_notes
from quatprop.errors import QuatpropError
from quatprop.provenance import digest_of
from quatprop.text import Setting, plain, quoted, spelled
from quatprop.version import __version__
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.check.judge import Judgement
    from quatprop.logs.attitude_input import LoadedAttitudes

LEAST_COVERED = 50.0
"""Percentage of the old reference with which the new attitudes must be compared."""


class Baseline(NamedTuple):
    """An earlier pin with which an update compares a new one: that of the case, or of an orphan.

    An orphan is a pin or a stored reference of no case in the suite: perhaps a renamed case.

    `names`: of the case, and of its log if that is known
    `label`: the line above the changes of an orphan; empty if it is the case itself
    `way_out`: what to do with an orphan that is a different case
    `is_pinned`: whether the orphan is in the lock
    """

    pin: Pin
    names: tuple[str, ...] = ()
    label: str = ""
    way_out: str = ""
    is_pinned: bool = False


def find_orphans(
    suite: Path, cases: Sequence[Case | CaseNotRun], pins: Mapping[str, Pin]
) -> Iterator[Baseline]:
    """Yield the pins and the stored references of no case in the suite."""
    case_names = {case.name for case in cases}
    names_by_digest: dict[str | None, tuple[str, ...]] = {}
    pinned_digests = {pin.reference for pin in pins.values()}
    has_new_case = not case_names <= pins.keys()
    for path in stray_references(suite.parent, cases) if has_new_case else []:
        pin, names = pin_of_reference(path)
        if pin is not None and pin.reference in pinned_digests:
            names_by_digest[pin.reference] = names
        elif pin is not None:
            label = f"compared with {plain(path)}, which no case has"
            yield Baseline(pin, names, label, "remove that file first")
    for name in [name for name in pins if name not in case_names]:
        label = f"compared with {quoted(name)}, which is pinned, but not in the suite"
        way_out = f"{Setting('update')} -k {shlex.quote(plain(name))}"
        way_out = f"remove that from the lock first, with {way_out}"
        names = (name, *names_by_digest.get(pins[name].reference, ()))
        yield Baseline(pins[name], names, label, way_out, is_pinned=True)


class Proposal(NamedTuple):
    """The proposed update of a case.

    `result`: the result, with the changes and the new pin
    `reference`: the new reference, not yet in its place; None to keep the old one
    `unmeasured`: why the change of the attitudes cannot be measured; empty if it can
    """

    result: CaseResult
    reference: Path | None = None
    unmeasured: str = ""


def refuse_target(case: Case, pin: Pin | None, folder: Path) -> None:
    """Refuse a case whose reference an update must not write."""
    if case.reference is not None:
        refuse_outside(case.reference, folder)
        refuse_lfs_pointer(case.reference)
        if pin is None or pin.reference is None:
            refuse_replacing(Path(case.reference))


def propose(
    case: Case, pin: Pin | None, judged: Judgement, folder: Path, orphans: Sequence[Baseline]
) -> Proposal:
    """Return the proposed update of a judged case.

    A case that passes keeps its reference: references that moved a little at every update would
    drift. Its attitudes were compared with the reference, so this version has confirmed it.

    `folder`: takes the new reference until it is accepted
    """
    losses = tuple(loss_notes(case, judged.run, judged.reference))
    new_remarks = tuple(
        f"remark: {text}"
        for code, text in judged.remarks.items()
        if (pin is None or code not in pin.remarks) and text not in losses
    )
    if pin is not None and judged.result.verdict == "pass":
        kept = pin._replace(quatprop=__version__, remarks=judged.new_pin.remarks)
        result = judged.result._replace(notes=losses, unpinned=(), changes=new_remarks)
        return Proposal(result._replace(updated="kept", pin=kept))
    baselines = [Baseline(pin)] if pin else _baselines_of_new_case(case, judged.new_pin, orphans)
    if case.reference is None:
        new_pin, target = judged.new_pin, None
        failures = filter(None, [judged.comparison and judged.comparison.failure])
        result = result_of(case, judged.comparison, "", [*failures], losses)
    else:
        target = folder / "reference.parquet"
        new_pin, summary = _make_reference(case, judged, target)
        result = CaseResult(case.name, "pass", summary=summary, notes=losses)
    changes, unmeasured = list[str](), ""
    is_unchanged = pin is not None and pin.reference == new_pin.reference == _digest_on_disk(case)
    for baseline in baselines:
        changes += filter(None, [baseline.label])
        changes += change_lines(case, baseline.pin, new_pin, judged.run)
        if case.reference is not None and not is_unchanged:
            lines, reason = _reference_changes(case, baseline, judged, new_pin, folder)
            changes, unmeasured = [*changes, *lines], unmeasured or reason
    updated = "updated" if changes else "kept" if baselines else "new"
    result = result._replace(
        updated=updated,
        changes=(*changes, *new_remarks),
        remarks=tuple(judged.remarks.values()),
        pin=new_pin,
    )
    return Proposal(result, None if updated == "kept" else target, unmeasured)


def put_in_place(case: Case, proposal: Proposal) -> None:
    """Replace the reference of a case by the proposed one."""
    if proposal.reference is not None:
        target = Path(str(case.reference))
        target.parent.mkdir(parents=True, exist_ok=True)
        with open_atomic(target) as stream:
            stream.write(proposal.reference.read_bytes())


def _make_reference(case: Case, judged: Judgement, target: Path) -> tuple[Pin, str]:
    """Write a new reference, and return the new pin of the case and a summary."""
    run, every = _decimated_run(case, judged, target.parent)
    if reason := too_sparse(case, run.series, run.samples, run.report.result.span_s):
        raise QuatpropError(reason)
    # A series that cannot be aligned even with itself would never pass.
    is_aligned = case.comparison.align != "none" or case.comparison.time_offset == "auto"
    if is_aligned and (reason := compare_case(case, run.series, run.series).impossible):
        raise QuatpropError(reason)
    write_reference(case, run, judged.new_pin.inputs, every, target)
    pin = judged.new_pin._replace(every=every, reference=sha256_of(str(target)))
    return pin, f"{len(run.series)} of {run.samples} attitudes in {plain(case.reference)}"


def _decimated_run(case: Case, judged: Judgement, folder: Path) -> tuple[CaseRun, int | None]:
    """Return a run that keeps every N-th attitude, few enough for a reference, and N."""
    if chooses_rows(case):
        return judged.run, None
    # The number of samples is known only after the run.
    every = decimation(judged.run.samples)
    as_judged = every == (judged.run.every or 1)
    return (judged.run if as_judged else propagate_case(case, every, folder)), every


def _baselines_of_new_case(case: Case, new_pin: Pin, orphans: Sequence[Baseline]) -> list[Baseline]:
    """Return the orphan that the new case most likely is, and the reference file it replaces.

    If no orphan shares its log or a name with the case, every pinned one is a baseline.
    """
    names = {case.name, Path(case.log).name}

    def similarity(orphan: Baseline) -> tuple[bool, bool, float]:
        same_log = orphan.pin.inputs.get("log", "") == new_pin.inputs.get("log")
        name_ratio = SequenceMatcher(None, orphan.names[0], case.name).ratio()
        return same_log, bool(names & {*orphan.names}), name_ratio

    similar = [orphan for orphan in orphans if any(similarity(orphan)[:2])]
    if similar:
        chosen = [max(similar, key=similarity)]
    else:
        chosen = [orphan for orphan in orphans if orphan.is_pinned]
    on_disk = _digest_on_disk(case)
    if on_disk is not None and all(orphan.pin.reference != on_disk for orphan in chosen):
        pin = pin_of_reference(Path(str(case.reference)))[0] or new_pin
        chosen.append(Baseline(pin._replace(reference=on_disk)))
    return chosen


def _digest_on_disk(case: Case) -> str | None:
    """Return the SHA-256 of the reference file of a case; None if there is no file."""
    return digest_of(case.reference).sha256 if case.reference else None


def _reference_changes(
    case: Case, baseline: Baseline, judged: Judgement, new_pin: Pin, folder: Path
) -> tuple[list[str], str]:
    """Return the changes of a reference, and why they cannot be measured; empty if they can."""
    path, new, pinned = Path(str(case.reference)), str(new_pin.reference), baseline.pin.reference
    on_disk = _digest_on_disk(case)
    replaced = on_disk if on_disk != new else pinned
    replaced_text = f"SHA-256 {replaced[:DIGITS]}" if replaced else "missing"
    lines = [f"reference: {replaced_text} -> SHA-256 {new[:DIGITS]}"]
    if pinned == new and on_disk is None:
        return lines, ""
    in_place = pinned in {on_disk, new}
    old = judged.reference if in_place else _find_moved_reference(case, pinned)
    if old is None:
        why = "could not be read" if pinned == on_disk else "is gone"
        reason = f"the old reference {why}" if pinned else "no reference was stored before"
        distance, share = f"not comparable: {reason}", 0.0
    elif chooses_rows(case) or not in_place:
        # The attitude that changed most need not be among those that the case keeps.
        distance, share = distance_text(propagate_all(case, folder).series, old.series)
    else:
        distance, share = distance_text(judged.run.series, old.series)
    cause = judged.comparison.cause if judged.comparison else ""
    lines.append(f"attitudes: {distance}" + (f"; likely cause: {cause}" if cause else ""))
    if share >= LEAST_COVERED:
        return lines, ""
    way_out = (
        f"restore the old one, or accept it unseen with {Setting('update')} {Setting('force')}"
    )
    if baseline.way_out:
        way_out += f"; if this is another case, {baseline.way_out}"
    return lines, spelled(
        f"{plain(path)}: the largest change of the attitudes cannot be measured: {distance}; "
        f"{way_out}"
    )


def _find_moved_reference(case: Case, digest: str | None) -> LoadedAttitudes | None:
    """Return the reference with a SHA-256, wherever it is in the folder of the suite."""
    path = with_content(Path(case.suite).parent, REFERENCES, digest) if digest else None
    return read_reference(str(path)) if path else None
