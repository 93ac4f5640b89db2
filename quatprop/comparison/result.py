"""The result of a comparison: errors, how they were obtained, verdicts, a likely cause.

Each limit on errors, drift and coverage is a criterion, judged by itself.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from quatprop.base.errors import ComparisonError
from quatprop.base.provenance import as_json
from quatprop.base.rendering import (
    angle_text,
    count_text,
    degrees_text,
    lines_of,
    loss_lines,
    rows_html,
    source_text,
)
from quatprop.base.text import Remark, Setting, plain, spelled
from quatprop.base.times import duration_text
from quatprop.kinematics.quaternion import conjugate, log, multiply, shorter
from quatprop.settings.command_options import ComparisonSettings, Sigmas

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from quatprop.base.arrays import Float64, Int64
    from quatprop.base.rendering import Row
    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.association import JudgedPairs, Matching, Pairs
    from quatprop.comparison.clock_offset import ClockOffset
    from quatprop.comparison.mistakes import Cause
    from quatprop.comparison.statistics import (
        ComparedSample,
        ErrorParts,
        ErrorStatistics,
        SigmaStatistics,
        WindowStatistics,
    )
    from quatprop.propagation.attitude_input import ReadAttitudes


class AppliedOffset(NamedTuple):
    """The time offset of a comparison.

    `added_to_b_ns`: time added to B's timestamps, ns
    `found`: the estimate; None if the offset was given
    `method_lag_ns`: the part of an estimate, ns, that is due to the integration rules of A and B,
        where a series without one does not lag; the rest is the offset between the clocks. None if
        neither rule is known, or the offset was given
    """

    added_to_b_ns: int
    found: ClockOffset | None
    method_lag_ns: int | None = None


class Criterion(NamedTuple):
    """A limit and whether it was met.

    `setting`: name of the setting with the limit, such as ``"rms_tol"``
    `label`: the limited quantity, in words
    `value`: measured value, in `unit`
    `limit`: largest, or for a coverage smallest, allowed value, in `unit`
    `unit`: ``"rad"``, ``"deg/h"``, ``"%"`` or ``"sigma"``
    `passed`: whether the value is at most, or for a coverage at least, the limit
    """

    setting: str
    label: str
    value: float
    limit: float
    unit: str
    passed: bool


class Coverage(NamedTuple):
    """How much of the reference, B, and of A was compared, in percent.

    `time`: time between consecutive pairs, as a percentage of B's time; gaps are omitted in both
    `samples`: percentage of B's samples; None if they were interpolated
    `time_of_a`: as `time`, for A
    """

    time: float
    samples: float | None
    time_of_a: float

    @property
    def least(self) -> float:
        """The smaller of `time` and `samples`."""
        return self.time if self.samples is None else min(self.time, self.samples)


USUAL_COVERAGE = 25.0
"""Minimum coverage of either series, in percent, if an error is limited and no coverage is set."""


def judge(settings: ComparisonSettings, measured: Comparison) -> Iterator[Criterion]:
    """Yield the verdict on each criterion in the settings."""
    for setting, label, name in (
        ("tol", "largest error", "max"),
        ("rms_tol", "RMS error", "rms"),
        ("final_tol", "final error", "final"),
        ("p95_tol", "95 % error", "p95"),
        ("max_sigma", "largest error", "max"),
    ):
        limit = getattr(settings, setting)
        if limit is None:
            continue
        in_sigma = isinstance(limit, Sigmas)
        if in_sigma and measured.sigmas is None:
            shown = "" if setting == "max_sigma" else str(limit)
            raise ComparisonError(
                f"neither series has standard deviations, which {Setting(setting, shown)} needs; "
                f"write them with {Setting('sigma')}"
            )
        value = getattr(measured.sigmas if in_sigma else measured.error_rad, name)
        most, unit = (limit.count, "sigma") if in_sigma else (limit, "rad")
        yield Criterion(setting, label, value, most, unit, value <= most)
    window, parts = measured.window, measured.parts
    for setting, label, size, unit in (
        ("window_tol", "worst error over windows", window.max_rad if window else None, "rad"),
        ("window_rms_tol", "RMS error over windows", window.rms_rad if window else None, "rad"),
        ("tol_heading", "error in heading", parts.heading.max if parts else None, "rad"),
        (
            "tol_inclination",
            "error in inclination",
            parts.inclination.max if parts else None,
            "rad",
        ),
        ("drift_tol", "drift", measured.drift_deg_h, "deg/h"),
        ("min_coverage", "coverage", measured.coverage.least, "%"),
    ):
        if (limit := getattr(settings, setting)) is None:
            continue
        if size is None:
            raise ComparisonError(
                f"one pair of attitudes shows no drift; omit {Setting('drift_tol')}"
            )
        passed = size >= limit if setting == "min_coverage" else abs(size) <= limit
        yield Criterion(setting, label, size, limit, unit, passed)
    least = min(measured.coverage.time, measured.coverage.time_of_a)
    if settings.min_coverage is None and settings.is_limited and least < USUAL_COVERAGE:
        yield Criterion("min_coverage", "coverage", least, USUAL_COVERAGE, "%", passed=False)


@dataclass(frozen=True, slots=True, repr=False, eq=False, kw_only=True)
class Comparison:
    """The geodesic error between two attitude series A and B.

    Parameters
    ----------
    pairs
        The compared pairs; None if files were compared while they were read.
    errors
        Geodesic errors of the pairs, shape ``(N,)``, rad; empty if there are no pairs.
    matching
        How the attitudes were matched in time.
    judged
        The pairs that were judged; None: all.
    time_offset
        The offset added to B's timestamps.
    alignment
        How B was rotated.
    error_rad
        Statistics of the errors, rad.
    drift_deg_h
        Slope of the errors over time, deg/h; None if all timestamps are equal, or B was aligned by
        all pairs.
    worst
        The pair with the largest error.
    window
        Errors of the rotations over windows; None if not requested.
    parts
        The errors in heading, in inclination and about reference axes, with the alignment
        ``"yaw"`` or a limit on one of them.
    sigmas
        The errors in standard deviations; None if neither series has any.
    coverage
        How much of B, and of the time of A, was compared.
    omitted_duplicates
        Number of attitudes of A and B omitted because of a repeated timestamp.
    outside_range
        Number of attitudes of A and B outside the time range.
    tolerance_rad
        Maximum error that passes, rad; None: no limit.
    criteria
        The verdict on each criterion.
    passed
        Whether all criteria passed; None if there are none.
    first_exceeding
        The first pair with an error above the tolerance.
    likely_cause
        A mistake that explains most of the error; None if none does, or all criteria passed.
    remarks
        Anything else worth knowing about the result.
    """

    pairs: Pairs | None = field(repr=False)
    errors: Float64 = field(repr=False)
    matching: Matching
    judged: JudgedPairs | None
    time_offset: AppliedOffset
    alignment: Alignment
    error_rad: ErrorStatistics
    drift_deg_h: float | None
    worst: ComparedSample
    window: WindowStatistics | None
    parts: ErrorParts | None
    sigmas: SigmaStatistics | None
    coverage: Coverage
    omitted_duplicates: int
    outside_range: int = 0
    tolerance_rad: float | None
    criteria: tuple[Criterion, ...] = ()
    passed: bool | None = None
    first_exceeding: ComparedSample | None
    likely_cause: Cause | None = None
    remarks: tuple[Remark, ...]

    def __repr__(self) -> str:
        largest, rms = degrees_text(self.error_rad.max), degrees_text(self.error_rad.rms)
        verdict = {True: ", passed", False: ", failed", None: ""}[self.passed]
        return f"<Comparison: {self.matching.matched:,} pairs, max {largest}, RMS {rms}{verdict}>"

    def __str__(self) -> str:
        return "\n".join(lines_of(result_rows(self)))

    def _repr_html_(self) -> str:
        """Return the result as a table, for notebooks."""
        return rows_html(repr(self).strip("<>"), result_rows(self))

    @property
    def t_ns(self) -> Int64:
        """Times of the pairs, shape ``(N,)``, ns, in A's clock."""
        return np.empty(0, np.int64) if self.pairs is None else self.pairs.t_ns

    @property
    def error_vectors(self) -> Float64:
        """Rotation vectors from B to A in the body frame, shape ``(N, 3)``, rad."""
        if self.pairs is None:
            return np.empty((0, 3))
        step = multiply(conjugate(self.alignment.apply(self.pairs.b)), self.pairs.a)
        return log(shorter(step))

    def report(self) -> Mapping[str, Any]:
        """Return everything except the arrays, ready for JSON."""
        report: Mapping[str, Any] = as_json(self)
        return report


# A comparison as rows of text, for the command line and the HTML page.


STATISTICS = {"rms": "RMS", "p95": "95 %"}
"""Labels of statistics that differ from their names."""


def comparison_rows(a: ReadAttitudes, b: ReadAttitudes, comparison: Comparison) -> Iterator[Row]:
    """Yield rows on what was compared, how, and the result."""
    yield "A", _series(a)
    yield "B", _series(b)
    yield from _outcome(comparison)
    yield from _remarks("A", a)
    yield from _remarks("B", b)
    for remark in comparison.remarks:
        yield "remark", spelled(remark)


def result_rows(comparison: Comparison) -> Iterator[Row]:
    """Yield rows on how two series were compared, and the result."""
    yield from _outcome(comparison)
    for remark in comparison.remarks:
        yield "remark", spelled(remark)


def _outcome(comparison: Comparison) -> Iterator[Row]:
    first_ns = comparison.matching.first_ns
    yield from _method(comparison)
    yield from _errors(comparison)
    yield "worst", _sample(comparison.worst, first_ns)
    if comparison.window:
        yield "window", _window(comparison.window, first_ns)
    if parts := comparison.parts:
        yield from _parts(parts)
    if sigmas := comparison.sigmas:
        yield "sigma", _sigmas(sigmas, first_ns)
    for criterion in comparison.criteria:
        yield "passed" if criterion.passed else "failed", criterion_text(criterion, comparison)
    if cause := comparison.likely_cause:
        for each in cause.chain:
            yield "cause", f"likely ({each.name}): {spelled(each.advice)}"


def criterion_text(criterion: Criterion, comparison: Comparison) -> str:
    """Return the measured and the allowed value of a criterion."""
    label, value, limit = criterion.label, criterion.value, criterion.limit
    if criterion.unit == "sigma":
        return f"{label} {sigma_text(value)}, at most {limit:.6g} sigma"
    match criterion.setting:
        case "tol":
            tolerance = f"the tolerance {angle_text(limit)}"
            if comparison.first_exceeding is None:
                return f"no error above {tolerance}"
            first = _sample(comparison.first_exceeding, comparison.matching.first_ns)
            return f"above {tolerance}, first at {first}"
        case "drift_tol":
            return f"{label} {value:+.6g} deg/h, at most {limit:.6g} deg/h"
        case "min_coverage":
            covered = comparison.coverage
            share = covered.samples
            samples = "" if share is None else f" and {share:.4g} % of the samples"
            of_a = (
                f" and {covered.time_of_a:.4g} % of the time of A" if value < covered.least else ""
            )
            shares = f"{covered.time:.4g} % of the time{samples} of B{of_a}"
            return f"{label} {shares}, at least {limit:.6g} %"
        case _:
            return f"{label} {angle_text(value)}, at most {angle_text(limit)}"


def sigma_text(count: float) -> str:
    """Return an error in standard deviations."""
    return f"{count:.3g} sigma" if math.isfinite(count) else "infinite in sigma (sigma is 0)"


def with_names(sentence: str, a: str, b: str) -> str:
    """Return a sentence with A and B replaced by names, for readers who do not know A and B."""

    def named(found: re.Match[str]) -> str:
        name = a if found[1] == "A" else b
        return name + ("" if not found[2] else "'" if name.endswith("s") else "'s")

    return re.sub(r"\b([AB])\b('s)?", named, sentence)


def _series(operand: ReadAttitudes) -> str:
    source = operand.signal
    where = f"{plain(operand.input.path)} ({operand.kind})"
    span = duration_text(operand.last_ns - operand.first_ns)
    samples = f"{operand.samples} samples over {span}"
    layout = source.layout or source.representation
    meaning = f"{source.meaning.convention} {source.meaning.direction}, {layout}"
    return f"{where}: {source_text(source.name, source.type_name)}, {samples}; {meaning}"


def _method(comparison: Comparison) -> Iterator[Row]:
    offset, alignment = comparison.time_offset, comparison.alignment
    if comparison.outside_range:
        yield "range", f"{count_text(comparison.outside_range, 'attitude')} outside it omitted"
    matching = comparison.matching
    span = duration_text(matching.last_ns - matching.first_ns)
    counts = f"{matching.matched} of {matching.candidates} samples over {span}"
    yield "matched", f"{counts}: {matching_text(matching)}"
    if part := comparison.judged:
        ranges = count_text(len(part.ranges_ns), "time range")
        by = {"all": "by all of them", "judged": "by those judged"}[alignment.range]
        aligned = "" if alignment.name == "none" else f"; B is aligned {by}"
        yield "judged", f"{part.pairs} of them, in {ranges}{aligned}"
    shifted = f"{duration_text(offset.added_to_b_ns)} added to B's timestamps"
    if found := offset.found:
        shifted += (
            f" +- {duration_text(round(found.std_ns))}, estimated from angular speeds: correlation "
            f"{found.correlation:.4f}, next best elsewhere {found.runner_up:.4f}"
        )
    if offset.added_to_b_ns or found:
        yield "offset", shifted
    if found and (lag_ns := offset.method_lag_ns):
        clocks, lag = duration_text(offset.added_to_b_ns - lag_ns), duration_text(lag_ns)
        rules = f"{lag} are due to the integration rules that the series state"
        yield "", f"of which {rules}, and {clocks} to the clocks if they lag by nothing else"
    rotated = f"{alignment.name}: reference frame rotated by {angle_text(alignment.reference_rad)}"
    if fit := alignment.mounting:
        yield "alignment", f"{rotated}, body frame by {angle_text(alignment.mount_rad)}"
        first, second, third = fit.singular_values
        turned = f"{degrees_text(fit.turn_rad, 3)} (RMS)"
        axes = f"in the ratio 1 : {second / first:.2g} : {third / first:.2g}"
        std = degrees_text(fit.std_rad, 2)
        yield "", f"from {fit.motions} rotations of {turned}, their axes {axes}; +- {std}"
    elif alignment.name != "none":
        yield "alignment", rotated


def matching_text(matching: Matching) -> str:
    """Return how attitudes were matched in time."""
    reach = duration_text(matching.max_dt_ns)
    other = "A" if matching.at == "B" else "B"
    method = {
        "exact": "equal timestamps",
        "nearest": f"{other} nearest to {matching.at} within {reach}, not interpolated",
        "interpolate": (
            f"{other} interpolated at the timestamps of {matching.at}, over at most {reach}"
        ),
    }
    if matching.rate_hz is not None:
        method["interpolate"] = f"interpolated at {matching.rate_hz:.9g} Hz, B over at most {reach}"
    return method[matching.match]


def _errors(comparison: Comparison) -> Iterator[Row]:
    yield "error", "geodesic angle"
    for name, error in comparison.error_rad._asdict().items():
        label = STATISTICS.get(name, name)
        yield f"  {label}", f"{error:14.6e} rad {math.degrees(error):14.6g} deg"
    if comparison.drift_deg_h is not None:
        # Rounding errors are not a drift.
        drift = round(comparison.drift_deg_h, 9) or 0.0
        # A slope across a step is not a drift.
        steps = any(remark.code == "step-at-gap" for remark in comparison.remarks)
        slope = "slope of the error, including the jump at a gap" if steps else "slope of the error"
        yield "drift", f"{f'{drift:+.6g}' if drift else '0'} deg/h, {slope}"


def _window(window: WindowStatistics, first_ns: int) -> str:
    return (
        f"{window.count} of {duration_text(window.window_ns)}: max {angle_text(window.max_rad)}, "
        f"RMS {angle_text(window.rms_rad)}; the worst begins at {window.worst_ns} ns, "
        f"{duration_text(window.worst_ns - first_ns)} after the first"
    )


def _parts(parts: ErrorParts) -> Iterator[Row]:
    for name, extent in parts._asdict().items():
        text = f"max {angle_text(extent.max)}, RMS {angle_text(extent.rms)}"
        yield "parts" if name == "heading" else "", f"{name.replace('_', ' ')}: {text}"


def _sigmas(sigmas: SigmaStatistics, first_ns: int) -> str:
    final, when = sigma_text(sigmas.final), f"at +{duration_text(sigmas.max_ns - first_ns)}"
    if math.isinf(sigmas.max):
        return f"the final error is {final}, the largest {sigma_text(sigmas.max)} {when}"
    return f"the final error is {final}, RMS {sigmas.rms:.3g}, at most {sigmas.max:.3g} {when}"


def _sample(sample: ComparedSample, first_ns: int) -> str:
    since = duration_text(sample.t_ns - first_ns)
    return (
        f"sample {sample.index} of {sample.at}, {sample.t_ns} ns, {since} after the first: "
        f"{angle_text(sample.error_rad)}"
    )


def _remarks(name: str, operand: ReadAttitudes) -> Iterator[Row]:
    for remark in operand.signal.remarks:
        yield "remark", f"{name}: {spelled(remark)}"
    if operand.counts.invalid:
        yield "lost", f"{count_text(operand.counts.invalid, 'invalid quaternion')} of {name}"
    for line in loss_lines(operand.losses):
        yield "", line
