"""The result of a comparison: errors, how they were obtained, verdicts, a likely cause.

Each limit on errors, drift and coverage is a criterion, judged by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from quatprop.comparison.settings import ComparisonSettings, Sigmas
from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import conjugate, log, multiply, shorter
from quatprop.provenance import as_json
from quatprop.rendering import degrees_text
from quatprop.text import Remark, Setting

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from quatprop.arrays import Float64, Int64
    from quatprop.comparison.accumulator import ComparedSample
    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.association import Matching, Pairs
    from quatprop.comparison.cause import Cause
    from quatprop.comparison.clocks import ClockOffset
    from quatprop.comparison.heading import ErrorParts
    from quatprop.comparison.judged import Judged
    from quatprop.comparison.statistics import ErrorStatistics, SigmaStatistics, WindowStatistics


class AppliedOffset(NamedTuple):
    """The time offset of a comparison.

    `added_to_b_ns`: time added to B's timestamps, ns
    `found`: the estimate; None if the offset was given
    """

    added_to_b_ns: int
    found: ClockOffset | None


class Criterion(NamedTuple):
    """A limit and whether it was met.

    `setting`: name of the setting with the limit, such as ``"rms_tol"``
    `label`: the limited quantity, in words
    `value`, `limit`: measured and allowed value, in `unit`
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
        """The smaller of the two."""
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
    association
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
    left_out
        Number of attitudes of A and B omitted because of a repeated timestamp.
    outside
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
    association: Matching
    judged: Judged | None
    time_offset: AppliedOffset
    alignment: Alignment
    error_rad: ErrorStatistics
    drift_deg_h: float | None
    worst: ComparedSample
    window: WindowStatistics | None
    parts: ErrorParts | None
    sigmas: SigmaStatistics | None
    coverage: Coverage
    left_out: int
    outside: int = 0
    tolerance_rad: float | None
    criteria: tuple[Criterion, ...] = ()
    passed: bool | None = None
    first_exceeding: ComparedSample | None
    likely_cause: Cause | None = None
    remarks: tuple[Remark, ...]

    def __repr__(self) -> str:
        largest, rms = degrees_text(self.error_rad.max), degrees_text(self.error_rad.rms)
        verdict = {True: ", passed", False: ", failed", None: ""}[self.passed]
        return (
            f"<Comparison: {self.association.matched:,} pairs, max {largest}, RMS {rms}{verdict}>"
        )

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
