"""Run a case: propagate its log, and compare the attitudes."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.check.case import Case, Limit
from quatprop.comparison.compare import compare
from quatprop.comparison.settings import ComparisonSettings
from quatprop.comparison.summary import criterion_text, matching_text, with_names
from quatprop.errors import ComparisonError
from quatprop.logs.attitude_input import AttitudeInput, LoadedAttitudes, load_attitudes
from quatprop.pipeline.job import Job, run
from quatprop.pipeline.settings import OutputSettings
from quatprop.rendering import degrees_text
from quatprop.settings.spelling import suite_key
from quatprop.text import Setting, plain, spelled
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.comparison.result import Comparison, Criterion
    from quatprop.pipeline.report import RunReport
    from quatprop.series import AttitudeSeries

MEASURE = ComparisonSettings(tol=math.inf, min_coverage=0.0)
"""Accepts every error, so that no causes are looked for."""

ALL = 99.9999
"""Coverage of a reference, %, that counts as complete: less only by rounding."""

SHOWN_DEG = 1e-6
"""Smallest rotation of an alignment that is shown, deg; smaller ones are rounding errors."""

TRACE_PARTS = 64
"""Number of points in a small plot of the error over time."""


class CaseRun(NamedTuple):
    """The attitudes of a case, and the file that contains them.

    `every`: every N-th attitude was kept; None if the case has settings for that, or all were kept
    """

    attitudes: LoadedAttitudes
    report: RunReport
    every: int | None

    @property
    def series(self) -> AttitudeSeries:
        """The attitudes themselves."""
        return self.attitudes.series

    @property
    def samples(self) -> int:
        """Number of samples that were propagated."""
        return self.report.result.samples


class CaseComparison(NamedTuple):
    """The comparison of the attitudes of a case with its reference.

    `result`: None if they cannot be compared
    `impossible`: why they cannot be compared; empty if they can
    `summary`: the worst error, its time, and the margin of each limit; empty without a result
    `failure`: why the error is not accepted; empty if it is accepted
    `cause`: the likely cause of the error; empty if unknown
    `trace`: the error over time, rad: the maximum of each part
    """

    result: Comparison | None
    impossible: str = ""
    summary: str = ""
    limits: tuple[Limit, ...] = ()
    failure: str = ""
    cause: str = ""
    trace: tuple[float, ...] = ()


def propagate_case(case: Case, every: int | None, folder: Path) -> CaseRun:
    """Propagate the log of a case to a file in a folder."""
    output = str(folder / f"attitude-{every}.parquet")
    settings = case.propagation
    if chooses_rows(case):
        every = None
    else:
        settings = replace(settings, every=every)
    report = run(Job(case.log, OutputSettings(output, to="parquet"), settings))
    return CaseRun(load_attitudes(AttitudeInput(output, "parquet")), report, every)


def propagate_all(case: Case, folder: Path) -> CaseRun:
    """Propagate the log of a case, keeping all attitudes whatever its settings."""
    settings = replace(case.propagation, every=None, rate=None, at=None)
    (place := folder / "all").mkdir(exist_ok=True)
    return propagate_case(case._replace(propagation=settings), None, place)


def chooses_rows(case: Case) -> bool:
    """Return whether the case has settings for the attitudes to keep."""
    settings = case.propagation
    return any(choice is not None for choice in (settings.every, settings.rate, settings.at))


def compare_case(case: Case, a: AttitudeSeries, b: AttitudeSeries) -> CaseComparison:
    """Compare the attitudes of a case, `a`, with the reference, `b`."""
    named = partial(with_names, a="the log's attitudes", b="the reference series")
    try:
        result = compare(a, b, case.comparison)
    except ComparisonError as error:
        return CaseComparison(None, _no_overlap(case, a, b) or named(str(error)))

    def since(t_ns: int) -> str:
        return f"+{duration_text(t_ns - result.association.first_ns)}"

    failures, first = [], result.first_exceeding
    if first is not None:
        failures.append(f"above the tolerance, first at {since(first.t_ns)} ({first.t_ns} ns)")
    limits, worst, left, others = [], [case.angle_text(result.worst.error_rad)], "", []
    for criterion in result.criteria:
        limits.append(limit := _limit(case, criterion))
        if (criterion.setting, criterion.unit) == ("tol", "rad"):
            # The summary begins with the worst error; `failures` has the first one above.
            worst.append(limit.limit)
            left = f", {limit.left}" if limit.left else ""
            continue
        others.append(str(limit))
        if not criterion.passed:
            failures.append(named(criterion_text(criterion, result)))
    if {"match", "max-dt"} & case.comparison_options.keys():
        others.append(named(matching_text(result.association)))
    if judged := case.comparison_options.get("judge"):
        others.append(f"judged at {plain(judged)} alone")
    others += _alignment_texts(result)
    cause = result.likely_cause
    causes = cause.chain if cause else []
    parts = np.array_split(result.errors, min(TRACE_PARTS, len(result.errors)))
    return CaseComparison(
        result,
        summary="; ".join([f"{' of '.join(worst)} at {since(result.worst.t_ns)}{left}", *others]),
        limits=tuple(limits),
        failure="; ".join(failures),
        cause="; ".join(f"{named(step.sentence)} ({step.name})" for step in causes),
        trace=tuple(float(part.max()) for part in parts),
    )


def _alignment_texts(result: Comparison) -> Iterator[str]:
    """Yield the time offset and the rotations by which the reference was aligned."""
    if offset := result.time_offset.added_to_b_ns:
        yield f"with the reference timestamps shifted by {duration_text(offset)}"
    for frame, angle in (
        ("reference frame", result.alignment.reference_rad),
        ("body frame", result.alignment.mount_rad),
    ):
        if math.degrees(angle) > SHOWN_DEG:
            yield f"with the {frame} of the reference attitudes rotated by {degrees_text(angle)}"


def _limit(case: Case, criterion: Criterion) -> Limit:
    """Return a criterion as text."""
    key = suite_key(criterion.setting)
    if criterion.unit == "%":
        label, limit = "reference covered", f"at least {criterion.limit:.6g} %"
        return Limit(key, label, f"{criterion.value:.4g} %", limit, "")
    if criterion.unit == "rad":
        value, limit = case.angle_text(criterion.value), case.angle_text(criterion.limit)
    else:
        value, limit = f"{criterion.value:.3g}", f"{criterion.limit:.6g} {criterion.unit}"
    used = abs(criterion.value) / criterion.limit if criterion.limit else 1.0
    left = f"{100 * (1 - used):.0f} % left"
    return Limit(key, criterion.label, value, limit, left if criterion.passed else "")


def _no_overlap(case: Case, a: AttitudeSeries, b: AttitudeSeries) -> str:
    """Return an error if two series have no time in common; empty if they overlap.

    It does not suggest the offset between them, which would be different in the next run.
    """
    offset = case.comparison.time_offset
    t_a, t_b = a.t_ns, b.t_ns + (offset if isinstance(offset, int) else 0)
    if not len(a) or not len(b) or (t_a.min() <= t_b.max() and t_b.min() <= t_a.max()):
        return ""
    spans = [f"from {t.min()} to {t.max()} ns" for t in (t_a, t_b)]
    ways = [Setting("clock"), Setting("start"), Setting("time_unit")]
    if case.external is not None:
        ways += [Setting("clock", side="b"), Setting("time_offset", "auto")]
    return spelled(
        f"the log's attitudes ({spans[0]}) and the reference attitudes ({spans[1]}) have no "
        f"time in "
        "common: their timestamps are from different clocks or different recordings; see "
        f"{', '.join(ways)}"
    )


def distance_text(a: AttitudeSeries, b: AttitudeSeries) -> tuple[str, float]:
    """Return the distance between attitudes, without alignment, as text, or why it is unknown.

    The second value is the percentage of `b` that was compared.
    """
    try:
        result = compare(a, b, MEASURE)
    except ComparisonError as error:
        named = with_names(str(error), a="the new attitudes", b="the old reference")
        return f"not comparable with the old reference: {named}", 0.0
    sizes = zip(("max", "RMS", "final"), largest_errors(result), strict=True)
    # Rounding errors are not a change.
    sentence = ", ".join(f"{name} {degrees_text(round(size, 12))}" for name, size in sizes)
    share = result.coverage.least
    part = "the old reference" if share > ALL else f"the {share:.4g} % of the old reference covered"
    return f"{sentence} from {part}", share


def largest_errors(result: Comparison) -> tuple[float, float, float]:
    """Return the worst, the RMS and the final error, rad."""
    return result.error_rad.max, result.error_rad.rms, result.error_rad.final


def compare_timestamps(a: AttitudeSeries, b: AttitudeSeries) -> str:
    """Return how timestamps differ from those of a reference; empty if they do not."""
    if len(a) != len(b):
        return f"there are {len(a)} attitudes, and {len(b)} reference attitudes"
    (differing,) = (a.t_ns != b.t_ns).nonzero()
    if not len(differing):
        return ""
    first = int(differing[0])
    return (
        f"{len(differing)} of {len(a)} timestamps differ from those of the reference file, "
        f"the first at attitude "
        f"{first}: {a.t_ns[first]} ns, not {b.t_ns[first]} ns"
    )
