"""Compare two attitude series: match them in time, align them, measure the error."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.accumulator import CoveredTime, ErrorAccumulator
from quatprop.comparison.alignment import align
from quatprop.comparison.association import Matching, Pairs, associate, shifted
from quatprop.comparison.cause import NO_ERROR
from quatprop.comparison.clocks import find_offset
from quatprop.comparison.defects import defects
from quatprop.comparison.diagnosis import MIN_PAIRS, likely_cause
from quatprop.comparison.heading import error_parts
from quatprop.comparison.judged import ComparedRange, Judged, judged, resampled
from quatprop.comparison.result import AppliedOffset, Comparison, Coverage, judge
from quatprop.comparison.settings import ComparisonSettings
from quatprop.comparison.statistics import sigma_statistics, window_statistics
from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import UNIT_TOLERANCE, geodesic_angle, normalize
from quatprop.rendering import count_text
from quatprop.series.blocks import blocks
from quatprop.text import Remark

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.arrays import Float64
    from quatprop.series import AttitudeSeries


ROUNDING = 1e-14
"""Deviation from unit length below which quaternions are not normalised, which takes a copy."""

FLOOR_SHARE = 0.1
"""Share of the tolerance above which interpolation errors get a remark."""

OPPOSED = math.radians(175.0)
"""Inclination, rad, at which heading is meaningless."""

SMALL_ERROR = 0.5
"""Error, rad, below which it makes sense to compare the signs of quaternions."""


def compare(
    a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings | None = None
) -> Comparison:
    """Measure the geodesic error between two attitude series, after sorting and normalising."""
    settings = settings or ComparisonSettings()
    remarks: list[Remark] = []
    (a, lost_of_a), (b, lost_of_b) = _sorted(a, "A", remarks), _sorted(b, "B", remarks)
    within, floor_rad = ComparedRange(settings, a), 0.0
    a = within.of(a, "A")
    found = find_offset(a, b) if settings.time_offset == "auto" else None
    offset = AppliedOffset(found.ns if found else int(settings.time_offset), found)
    b = within.of(shifted(b, offset.added_to_b_ns), "B")
    remarks += within.remarks()
    if settings.rate is not None:
        a, floor_rad = resampled(a, settings.rate, remarks)
    pairs = associate(a, b, settings)
    pairs = replace(pairs, floor_rad=max(floor_rad, pairs.floor_rad))
    matching, part = Matching.from_pairs(pairs), None
    if settings.rate is not None:
        matching = matching._replace(rate_hz=float(settings.rate))
    if settings.judge:
        pairs, part = judged(pairs, settings.judge)
    measured = ErrorAccumulator(
        pairs.at, align(settings.align, pairs.a, pairs.b), settings.limit_rad
    )
    measured.add(pairs.t_ns, pairs.index, pairs.a, pairs.b)
    of_a, of_b = (side if part is None else part.part_of(side) for side in (a, b))
    counted = pairs.match == "exact" or pairs.at == "B"
    coverage = Coverage(
        measured.covered.share_of(CoveredTime.of(of_b.t_ns)),
        100 * len(pairs) / len(of_b) if counted else None,
        measured.covered.share_of(CoveredTime.of(of_a.t_ns)),
    )
    comparison = build_comparison(
        a,
        b,
        settings,
        measured,
        matching,
        offset,
        coverage,
        pairs=pairs,
        part=part,
        left_out=lost_of_a + lost_of_b,
        remarks=remarks,
    )
    return replace(comparison, outside=sum(within.left_out))


def build_comparison(  # noqa: PLR0913, PLR0917  # all facts of a comparison
    a: AttitudeSeries,
    b: AttitudeSeries,
    settings: ComparisonSettings,
    measured: ErrorAccumulator,
    association: Matching,
    time_offset: AppliedOffset,
    coverage: Coverage,
    *,
    pairs: Pairs | None = None,
    part: Judged | None = None,
    left_out: int = 0,
    remarks: Sequence[Remark] = (),
) -> Comparison:
    """Judge and explain the errors, once all are measured.

    `pairs`: the compared pairs; None to omit pairs and errors from the result
    `part`: the pairs that are judged; None: all
    """
    window = parts = sigmas = None
    if pairs is not None:
        if settings.window:
            window = window_statistics(pairs, measured.alignment, settings.window)
        if settings.in_parts:
            parts = error_parts(pairs, measured.alignment)
        sigmas = sigma_statistics(a, b, pairs, measured.alignment)
    errors = measured.errors()
    final = float(errors[-1])
    if pairs is None:
        errors.sort()
    rising = errors if pairs is None else np.sort(errors)
    comparison = Comparison(
        pairs=pairs,
        errors=np.empty(0) if pairs is None else errors,
        association=association,
        judged=part,
        time_offset=time_offset,
        alignment=measured.alignment,
        error_rad=measured.statistics(rising, final),
        drift_deg_h=measured.drift_deg_h,
        worst=measured.worst,
        window=window,
        parts=parts,
        sigmas=sigmas,
        coverage=coverage,
        left_out=left_out,
        tolerance_rad=settings.limit_rad if math.isfinite(settings.limit_rad) else None,
        first_exceeding=measured.first_exceeding,
        remarks=(),
    )
    notes = (*remarks, *_remarks(comparison, settings, len(errors), measured.opposite_signs))
    criteria = tuple(judge(settings, comparison))
    passed = all(criterion.passed for criterion in criteria) if criteria else None
    if part is not None:
        a, b = part.part_of(a), part.part_of(b)
    cause = None
    # Pairs may be interpolated between samples that are not in the judged ranges.
    if not passed and min(len(rising), len(a), len(b)) >= MIN_PAIRS:
        # Of long files, the beginning alone may have too few pairs.
        with suppress(ComparisonError):
            # A defect without a remedy would make other mistakes look like the cause.
            found = defects(a, b, settings)
            notes += found
            if not found:
                cause = likely_cause(a, b, settings, rising, time_offset.added_to_b_ns)
    return replace(comparison, criteria=criteria, passed=passed, likely_cause=cause, remarks=notes)


def _remarks(
    comparison: Comparison, settings: ComparisonSettings, count: int, opposite_signs: int
) -> Iterator[Remark]:
    """Yield remarks on the result.

    `count`: number of pairs
    `opposite_signs`: number of pairs with quaternions of opposite sign
    """
    pairs, parts, sigmas = comparison.pairs, comparison.parts, comparison.sigmas
    if pairs and pairs.floor_rad > FLOOR_SHARE * settings.smallest_limit_rad:
        yield Remark(
            "interpolated",
            f"attitudes were interpolated between samples, which may cause errors of about "
            f"{math.degrees(pairs.floor_rad):.3g} deg",
        )
    if parts and parts.inclination.max > OPPOSED:
        yield Remark(
            "opposed-verticals",
            "the z axes of A and B point in opposite directions, so a heading error is not "
            "meaningful: is one of them north-east-down and the other east-north-up?",
        )
    exact = comparison.association.match == "exact"
    if exact and opposite_signs and comparison.worst.error_rad <= SMALL_ERROR:
        yield Remark(
            "opposite-signs",
            f"B has the opposite sign in {opposite_signs} of {count} samples: q and -q are the "
            "same attitude, so this is not an error",
        )
    if sigmas and math.isinf(sigmas.max):
        yield Remark(
            "exact-sigma",
            f"the error at {sigmas.max_ns} ns is infinitely many sigma: the attitude is given as "
            "exact, with sigma 0, and the error is beyond rounding",
        )


def unit(wxyz: Float64) -> Float64:
    """Return unit quaternions: the same array if they already are."""
    off = np.abs(np.sqrt(np.einsum("ij,ij->i", wxyz, wxyz)) - 1) > ROUNDING
    if off.any():
        wxyz = wxyz.copy()
        wxyz[off] = normalize(wxyz[off])
    return wxyz


def _sorted(series: AttitudeSeries, name: str, remarks: list[Remark]) -> tuple[AttitudeSeries, int]:
    """Return unit quaternions in order of time and the number left out, and add remarks.

    Of repeated timestamps the first is kept, and others are only counted if their attitude differs.
    """
    if not len(series):
        raise ComparisonError(f"{name} has no attitudes; check what was selected")
    deviation, invalid, first_invalid = 0.0, 0, 0
    for rows in blocks(len(series)):
        length = np.sqrt(np.einsum("ij,ij->i", series.wxyz[rows], series.wxyz[rows]))
        valid = np.isfinite(length) & (length > 0)
        if not invalid and not valid.all():
            first_invalid = rows.start + int(np.argmin(valid))
        invalid += len(valid) - int(np.count_nonzero(valid))
        deviation = max(deviation, float(np.max(np.abs(length - 1), initial=0.0, where=valid)))
    if invalid:
        raise ComparisonError(
            f"{name} has {invalid} of {len(series)} rows that are not attitudes (zero or not a "
            f"number), the first at index {first_invalid}; omit them"
        )
    if deviation > UNIT_TOLERANCE:
        text = f"{name} is not of unit length, by up to {deviation:.2g}; normalised"
        remarks.append(Remark("normalised", text))
    t_ns, wxyz = series.t_ns, unit(series.wxyz) if deviation > ROUNDING else series.wxyz
    intervals = np.diff(t_ns)
    if (intervals > 0).all():
        return replace(series, wxyz=wxyz), 0
    _, first, stamp = np.unique(t_ns, return_index=True, return_inverse=True)
    backwards, repeated = int((intervals < 0).sum()), len(t_ns) - len(first)
    others = int(np.count_nonzero(geodesic_angle(wxyz, wxyz[first[stamp]]) > NO_ERROR))
    said = []
    if backwards:
        times = count_text(backwards, "time")
        said.append(f"{name} was sorted by time: its timestamps step back {times}")
    if repeated:
        timestamps = f"{count_text(repeated, 'repeated timestamp')} of {name}"
        said.append(f"{timestamps} omitted, {others} with a different attitude")
    remarks.append(Remark("sorted", "; ".join(said)))
    return replace(series, wxyz=wxyz)[first], others
