"""Judge a case: propagate its log, compare the attitudes, and check them against the pin."""

from __future__ import annotations

import shlex
from difflib import SequenceMatcher
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base import __version__
from quatprop.base.errors import QuatpropError
from quatprop.base.places import without_secret
from quatprop.base.provenance import digest_of
from quatprop.base.text import Remark, Setting, plain, quoted, spelled
from quatprop.comparison.result import with_names
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.propagation.attitude_input import load_attitudes
from quatprop.tools.check.case import (
    Case,
    CaseComparison,
    CaseNotRun,
    CaseResult,
    CaseRun,
    Verdict,
    chooses_rows,
    compare_case,
    compare_timestamps,
    distance_text,
    propagate_all,
    propagate_case,
)
from quatprop.tools.check.changes import (
    MAX_ROWS,
    REFERENCES,
    change_lines,
    decimation,
    final_of,
    hash_inputs,
    make_pin,
    pin_mismatches,
    pin_of_reference,
    read_reference,
    refuse_replacing,
    stray_references,
    too_sparse,
    write_reference,
)
from quatprop.tools.check.lock import DIGITS, Pin, refuse_lfs_pointer, sha256_of, with_content
from quatprop.tools.check.pinned_numbers import (
    SAME_DEG,
    changed_numbers,
    final_apart_deg,
    moved_frames,
)
from quatprop.writers.atomic import write_atomic
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.propagation.attitude_input import LoadedAttitudes


# Remarks on the log and the reference of a case, by the codes that a lock pins.


def remarks_of(
    case: Case, run: CaseRun, reference: LoadedAttitudes | None, comparison: CaseComparison | None
) -> dict[str, Remark]:
    """Return the remarks on the log and on an independent reference, by code."""
    remarks = [remark.spelled(spelled) for remark in run.report.remarks]
    if case.external is not None and reference is not None:
        result = comparison and comparison.result
        for remark in (*reference.signal.remarks, *(result.remarks if result else ())):
            text = with_names(spelled(remark), a="the log's attitudes", b="the reference series")
            remarks.append(Remark(f"reference: {remark.code}", text))
    remarks += loss_notes(case, run, reference)
    return {remark.code: remark for remark in remarks}


def loss_notes(case: Case, run: CaseRun, reference: LoadedAttitudes | None) -> Iterator[Remark]:
    """Yield notes on files with lost data: the log, files next to it, the reference."""
    lost = "data of {} were lost or omitted, see {}"
    places = [loss.place for loss in run.report.losses]
    for name, path in case.propagation.inputs.items():
        own = [place for place in places if place.startswith(f"{plain(without_secret(path))}, ")]
        places = [place for place in places if place not in own]
        if own:
            yield Remark(f"{name}: data-lost", lost.format(plain(path), "propagate"))
    if places or run.report.counts.dropped:
        yield Remark("data-lost", lost.format(plain(case.log), "propagate"))
    if case.external is not None and reference is not None and reference.data_lost:
        text = lost.format(plain(case.external.path), "compare")
        yield Remark("reference: data-lost", text)


class Judgement(NamedTuple):
    """The result of a case, and the data it is based on.

    `reference`, `comparison`: None if there is no reference
    `new_pin`: the pin of an update, without its stored reference
    `remarks`: remarks on the log and the reference, by code
    """

    result: CaseResult
    run: CaseRun
    reference: LoadedAttitudes | None
    comparison: CaseComparison | None
    new_pin: Pin
    remarks: dict[str, Remark]


def judge(case: Case, pin: Pin | None, folder: Path) -> Judgement:
    """Compare a case with its reference, even if it does not match its pin.

    `pin`: None if the case was never updated
    `folder`: for the file of attitudes
    """
    hashes = hash_inputs(case, pin)
    changed = pin_mismatches(case, pin, hashes)
    try:
        run = propagate_case(case, _decimation(case, pin), folder)
        reference = _reference(case, may_be_broken=bool(changed))
    except QuatpropError as error:
        if changed and pin is not None:
            raise QuatpropError(f"{changed}; it cannot be compared now: {error}") from error
        if pin is not None and case.pins_log:
            used = f"the same bytes could be used by quatprop {pin.quatprop}"
            raise QuatpropError(f"{error}; {used}") from error
        raise
    comparison = None
    if reference is not None and case.external is None and pin is not None:
        # References pinned by an earlier version may be too sparse.
        changed = changed or too_sparse(case, reference.series, pin.samples, pin.span_s)
    if reference is not None:
        comparison = compare_case(case, run.series, reference.series)
    remarks = remarks_of(case, run, reference, comparison)
    notes: list[str] = [*loss_notes(case, run, reference)]
    if pin is not None and pin.quatprop != __version__:
        notes.append(
            f"the reference file was made by quatprop {pin.quatprop}, this is {__version__}"
        )
    unpinned = [code for code in remarks if pin and code not in pin.remarks]
    notes += [text for code, text in remarks.items() if code in unpinned and text not in notes]
    new_pin = make_pin(case, run, comparison, hashes, remarks)
    failures = [*filter(None, _failures(case, pin, run, reference, comparison))]
    if pin is not None:
        failures += [] if failures else changed_numbers(case, pin, run)
        failures += moved_frames(case, pin, new_pin)
    result = result_of(case, comparison, changed, failures, notes)
    result = result._replace(remarks=tuple(remarks.values()), unpinned=tuple(unpinned))
    return Judgement(result, run, reference, comparison, new_pin, remarks)


def result_of(
    case: Case,
    comparison: CaseComparison | None,
    changed: str,
    failures: Sequence[str],
    notes: Sequence[str],
) -> CaseResult:
    """Return the result of a case.

    `changed`: differences from the pin, and the remedy; empty if there are none
    `failures`: why the attitudes are not accepted
    """
    impossible = comparison.impossible if comparison else ""
    verdict: Verdict = "error" if changed or impossible else "fail" if failures else "pass"
    reasons = [changed, impossible, *failures]
    if failures and comparison and comparison.cause:
        reasons.append(f"likely cause: {comparison.cause}")
    reason = "" if verdict == "pass" else "; ".join(filter(None, [*reasons, *notes]))
    result = CaseResult(case.name, verdict, reason, notes=tuple(notes))
    if comparison is None or comparison.result is None:
        return result
    if (changed or failures) and not comparison.covers_reference:
        # The error of the remaining samples would be taken for that of the log.
        return result
    return result._replace(
        summary=comparison.summary,
        error_rad=comparison.result.worst.error_rad,
        limits=comparison.limits,
        comparison=comparison.result.report(),
        trace=comparison.trace,
    )


def _decimation(case: Case, pin: Pin | None) -> int | None:
    """Return N if every N-th attitude is enough to judge a case; None if all are needed."""
    if case.reference is None or not case.strict:
        # Missing samples shift the decimation: find the reference timestamps among all samples.
        return None
    if pin is not None:
        return pin.every
    return None if Path(case.reference).exists() else MAX_ROWS


def _reference(case: Case, *, may_be_broken: bool) -> LoadedAttitudes | None:
    """Return the reference of a case; None if there is none yet.

    `may_be_broken`: return None for an unreadable reference, whose change is reported already
    """
    if case.external is not None:
        return load_attitudes(case.external)
    path = str(case.reference)
    if not Path(path).exists():
        return None
    try:
        return read_reference(path)
    except QuatpropError:
        if may_be_broken:
            return None
        raise


def _failures(
    case: Case,
    pin: Pin | None,
    run: CaseRun,
    reference: LoadedAttitudes | None,
    comparison: CaseComparison | None,
) -> Iterator[str]:
    """Yield why the attitudes are not accepted; some sentences may be empty."""
    if pin is not None and run.samples != pin.samples and case.pins_log:
        yield f"{run.samples} samples were propagated, and {pin.samples} when pinned"
    if comparison is None or reference is None:
        return
    final = final_of(reference) if case.external is None else None
    if case.external is None and pin is not None:
        if final is None:
            yield "the reference file does not say what it was made from: check did not write it"
        elif (apart := final_apart_deg(pin, final)) > SAME_DEG:
            yield (
                f"the last attitudes in the lock and in the reference file are {apart:.6g} "
                f"deg apart"
            )
        if case.strict:
            yield compare_timestamps(run.series, reference.series)
    yield comparison.failure
    comparable = case.strict and case.comparison.align == "none" and comparison.result
    if final is not None and comparable and not comparison.failure:
        # The rows of the reference may lack the last sample.
        error = float(geodesic_angle(np.array(final), run.report.result.final_wxyz))
        if error > case.comparison.limit_rad:
            apart_text = f"{case.angle_text(error)} from the one in the reference file"
            yield f"the attitude at the last sample is {apart_text}"


# Update a case: make a new reference, and list the changes, with their size.


MIN_COVERED_PERCENT = 50.0
"""Percentage of the old reference with which the new attitudes must be compared."""


class Baseline(NamedTuple):
    """An earlier pin with which an update compares a new one: that of the case, or of an orphan.

    An orphan is a pin or a stored reference of no case in the suite: perhaps a renamed case.

    `names`: of the case, and of its log if that is known
    `label`: the line above the changes of an orphan; empty if it is the case itself
    `remedy`: how to treat an orphan that is a different case
    `is_pinned`: whether the orphan is in the lock
    """

    pin: Pin
    names: tuple[str, ...] = ()
    label: str = ""
    remedy: str = ""
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
        remedy = f"{Setting('update')} -k {shlex.quote(plain(name))}"
        remedy = f"remove that from the lock first, with {remedy}"
        names = (name, *names_by_digest.get(pins[name].reference, ()))
        yield Baseline(pins[name], names, label, remedy, is_pinned=True)


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


def install(case: Case, proposal: Proposal) -> None:
    """Replace the reference of a case by the proposed one."""
    if proposal.reference is not None:
        target = Path(str(case.reference))
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(target, proposal.reference.read_bytes())


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
    if share >= MIN_COVERED_PERCENT:
        return lines, ""
    remedy = f"restore the old one, or accept it unseen with {Setting('update')} {Setting('force')}"
    if baseline.remedy:
        remedy += f"; if this is another case, {baseline.remedy}"
    return lines, spelled(
        f"{plain(path)}: the largest change of the attitudes cannot be measured: {distance}; "
        f"{remedy}"
    )


def _find_moved_reference(case: Case, digest: str | None) -> LoadedAttitudes | None:
    """Return the reference with a SHA-256, wherever it is in the folder of the suite."""
    path = with_content(Path(case.suite).parent, REFERENCES, digest) if digest else None
    return read_reference(str(path)) if path else None
