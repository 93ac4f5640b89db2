"""Compare two attitude series: match them in time, align them, measure the error."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import ComparisonError
from quatprop.base.rendering import count_text, degrees_text
from quatprop.base.text import Remark, Setting
from quatprop.comparison.alignment import align_pairs
from quatprop.comparison.association import (
    ComparedRange,
    JudgedPairs,
    Matching,
    Pairs,
    associate,
    judged_pairs,
    resampled,
    shifted,
)
from quatprop.comparison.causes import ENOUGH, Search
from quatprop.comparison.clock_offset import find_offset
from quatprop.comparison.defects import defects, remaining_step
from quatprop.comparison.mistakes import NO_ERROR, Cause, Mistake, Sides, isolated_samples
from quatprop.comparison.result import AppliedOffset, Comparison, Coverage, judge
from quatprop.comparison.statistics import (
    CoveredTime,
    ErrorAccumulator,
    error_parts,
    sigma_statistics,
    window_statistics,
)
from quatprop.kinematics.quaternion import UNIT_TOLERANCE, geodesic_angle, normalize
from quatprop.kinematics.time_series import blocks, rms
from quatprop.settings.command_options import ComparisonSettings

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.kinematics.series import AttitudeSeries


# The likely causes of an error.
#
# Every cause was tested: undoing it removes most of the error of the series that are compared. Of
# the best hypothesis, the smallest subset of mistakes that does so is reported.


MIN_PAIRS = 10
"""Minimum number of pairs; fewer can be explained by almost anything."""

LITTLE = 0.1
"""RMS error, as a share of the limit on the largest error, that needs no further cause."""

MAX_CLAIMS = 3
"""Maximum number of causes, each of the residual of those before it."""

FRAMES = {"reference frame", "body frame"}
"""Mistakes that may hide all others, whatever their share of the error."""

LEAST_STEP = 0.1
"""RMS error, as a share of that of the comparison, below which no step is looked for."""

MAX_SHARE = 0.5
"""Maximum residual of a cause, as a share of the error."""


def likely_cause(
    sides: Sides,
    settings: ComparisonSettings,
    error: Float64,
    added_ns: int = 0,
    part: JudgedPairs | None = None,
) -> tuple[Cause | None, tuple[Remark, ...]]:
    """Return the likely cause of an error, or None, and remarks on what it leaves.

    `error`: the errors, rad, shape ``(N,)``, in rising order
    `added_ns`: time added to B's timestamps, ns
    `part`: the pairs that are judged; None: all
    """
    if rms(error) <= NO_ERROR:
        return None, ()
    if outliers := isolated_samples(error):
        return outliers, ()
    limit = settings.tol if isinstance(settings.tol, float) else 0.0
    part_ns = None
    a, b = (one if part is None else part.judged_samples(one) for one in (sides.a, sides.b))
    if len(associate(a, b, settings)) < len(error):
        part_ns = int(min(a.t_ns[-1], b.t_ns[-1]) - max(a.t_ns[0], b.t_ns[0]))
    cause: Cause | None = None
    undone: tuple[Mistake, ...] = ()
    left: tuple[Mistake, ...] = ()
    for claim, mistakes in reversed([*_claims(sides, settings, added_ns, LITTLE * limit, part)]):
        if claim is None:
            left = mistakes
        else:
            cause, undone = claim._replace(also=cause, part_ns=part_ns), mistakes + undone
    step = remaining_step(sides, settings, undone, left, part, LEAST_STEP * rms(error))
    return cause, (step,) if step else ()


def _claims(
    sides: Sides,
    settings: ComparisonSettings,
    added_ns: int,
    enough: float,
    part: JudgedPairs | None,
) -> Iterator[tuple[Cause | None, tuple[Mistake, ...]]]:
    """Yield causes, each of which explains most of the residual of those before it.

    The last one may be None: mistakes that only explain it together with what happens across gaps.

    `enough`: RMS error, rad, that needs no further cause
    """
    accepted: tuple[Mistake, ...] = ()
    for _ in range(MAX_CLAIMS):
        search = Search(sides, settings, added_ns, accepted, part)
        before = search.residual(())
        if not NO_ERROR < before < math.inf:
            return
        search.run(before)
        mistakes, after = _fewest(search, before)
        names = {each.name for each in mistakes}
        if not mistakes or names & {each.name for each in accepted}:
            yield None, search.best.mistakes
            return
        yield _described(mistakes, search.others, before, after), mistakes
        if not names <= FRAMES:
            enough = max(enough, ENOUGH * before)
        is_all = len(mistakes) == len(search.best.mistakes) and not search.is_partial
        # A rule does not determine the rate at one end; its error would look like that of a frame.
        if is_all or "method" in names or after <= enough:
            return
        accepted += mistakes


def _fewest(search: Search, before: float) -> tuple[tuple[Mistake, ...], float]:
    """Return the smallest subset of the best hypothesis that removes most of an error."""
    best = search.best.mistakes
    for size in range(1, len(best) + 1):
        tried = {search.residual(some): some for some in combinations(best, size)}
        if min(tried) <= MAX_SHARE * before:
            return tried[min(tried)], min(tried)
    return (), before


def _described(
    mistakes: tuple[Mistake, ...], others: list[str], before: float, after: float
) -> Cause:
    sentence = "; also, ".join(mistake.sentence for mistake in mistakes)
    if others:
        sentence += f"; this motion does not distinguish it from {' or '.join(others)}"
    if after <= NO_ERROR:
        sentence += f"; undoing it removes the RMS error of {degrees_text(before, 4)}"
    else:
        from_to = " to ".join(degrees_text(error, 4) for error in (before, after))
        sentence += f"; undoing it reduces the RMS error from {from_to}"
    remedy = "; and also, ".join(mistake.remedy for mistake in mistakes)
    name = " and ".join(mistake.name for mistake in mistakes)
    return Cause(name, sentence, before, after, remedy)


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
    within, interpolation_error_rad = ComparedRange(settings, a), 0.0
    a = within.cut(a, "A")
    found = find_offset(a, b) if settings.time_offset == "auto" else None
    offset = AppliedOffset(
        found.ns if found else int(settings.time_offset), found, _lag_ns(a, b) if found else None
    )
    b = within.cut(shifted(b, offset.added_to_b_ns), "B")
    remarks += within.remarks()
    if settings.rate is not None:
        a, interpolation_error_rad = resampled(a, settings.rate, remarks)
    pairs = associate(a, b, settings)
    pairs = replace(
        pairs, interpolation_error_rad=max(interpolation_error_rad, pairs.interpolation_error_rad)
    )
    matching, part, fitted = Matching.from_pairs(pairs), None, pairs
    if settings.rate is not None:
        matching = matching._replace(rate_hz=float(settings.rate))
    if settings.judge:
        pairs, part = judged_pairs(pairs, settings.judge)
        fitted = pairs if settings.align_range == "judged" else fitted
    alignment = align_pairs(settings.align, fitted, a, b)
    alignment = replace(alignment, range=settings.align_range)
    measured = ErrorAccumulator(pairs.at, alignment, settings.limit_rad)
    measured.add(pairs.t_ns, pairs.index, pairs.a, pairs.b)
    of_a, of_b = (side if part is None else part.judged_samples(side) for side in (a, b))
    counted = pairs.match == "exact" or pairs.at == "B"
    coverage = Coverage(
        measured.covered.share_of(CoveredTime.between(of_b.t_ns)),
        100 * len(pairs) / len(of_b) if counted else None,
        measured.covered.share_of(CoveredTime.between(of_a.t_ns)),
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
        omitted_duplicates=lost_of_a + lost_of_b,
        remarks=remarks,
    )
    return replace(comparison, outside_range=within.outside_range)


def _lag_ns(a: AttitudeSeries, b: AttitudeSeries) -> int | None:
    """Return how much more A lags than B because of integration rules, ns; None: neither has one.

    Recorded attitudes without a rule, as those of a motion capture, are taken as they are.
    """
    if a.lag_ns is None and b.lag_ns is None:
        return None
    return (a.lag_ns or 0) - (b.lag_ns or 0)


def build_comparison(  # noqa: PLR0913, PLR0917  # all facts of a comparison
    a: AttitudeSeries,
    b: AttitudeSeries,
    settings: ComparisonSettings,
    measured: ErrorAccumulator,
    matching: Matching,
    time_offset: AppliedOffset,
    coverage: Coverage,
    *,
    pairs: Pairs | None = None,
    part: JudgedPairs | None = None,
    omitted_duplicates: int = 0,
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
        matching=matching,
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
        omitted_duplicates=omitted_duplicates,
        tolerance_rad=settings.limit_rad if math.isfinite(settings.limit_rad) else None,
        first_exceeding=measured.first_exceeding,
        remarks=(),
    )
    notes = (*remarks, *_remarks(comparison, settings, len(errors), measured.opposite_signs))
    criteria = tuple(judge(settings, comparison))
    passed = all(criterion.passed for criterion in criteria) if criteria else None
    cause = None
    # Pairs may be interpolated between samples that are not in the judged ranges.
    samples = [len(one if part is None else part.judged_samples(one)) for one in (a, b)]
    if not passed and min(len(rising), *samples) >= MIN_PAIRS:
        # Of long files, the beginning alone may have too few pairs.
        with suppress(ComparisonError):
            # What a rule costs, and a defect without a remedy, look like other mistakes.
            cause = within_sensitivity(a, b, comparison)
            found = () if cause else defects(a, b, settings, part)
            if not cause and not found:
                sides, added_ns = Sides(a, b), time_offset.added_to_b_ns
                cause, found = likely_cause(sides, settings, rising, added_ns, part)
            notes += found
    return replace(comparison, criteria=criteria, passed=passed, likely_cause=cause, remarks=notes)


COST_MARGIN = 1.1
"""Largest error that is within the cost of integration rules, as a multiple of that cost."""

MINOR = 0.1
"""Share of that cost below which a side needs no better rule."""


def within_sensitivity(
    a: AttitudeSeries, b: AttitudeSeries, comparison: Comparison
) -> Cause | None:
    """Return the cause if the integration rules of A and B explain the largest error, else None."""
    largest, offset = comparison.error_rad.max, comparison.time_offset
    sides = {name: one.sensitivity for name, one in (("A", a), ("B", b)) if one.sensitivity}
    # The estimated offset contains most of what a rule with a lag costs.
    if not sides or comparison.error_rad.rms <= NO_ERROR or offset.method_lag_ns:
        return None
    costs = {name: one.angle_rad for name, one in sides.items()}
    cost = sum(costs.values())
    if len({one.rule for one in sides.values()}) < len(sides):
        # The same rule costs both about the same, which is no error.
        cost = abs(costs["A"] - costs["B"])
    if largest > COST_MARGIN * cost:
        return None
    named = [name for name in sides if costs[name] >= MINOR * cost]
    angles = " and ".join(degrees_text(costs[name], 3) for name in named)
    methods = " and ".join(f"{name} ({sides[name].rule[1]})" for name in named)
    better = " and ".join(f"{name} with {Setting('method', sides[name].better)}" for name in named)
    sentence = (
        f"the largest error, {degrees_text(largest, 4)}, is within what the integration method of "
        f"{methods} costs, {angles}, so no other cause was looked for"
    )
    return Cause("method", sentence, comparison.error_rad.rms, math.nan, f"propagate {better}")


def _remarks(
    comparison: Comparison, settings: ComparisonSettings, count: int, opposite_signs: int
) -> Iterator[Remark]:
    """Yield remarks on the result.

    `count`: number of pairs
    `opposite_signs`: number of pairs with quaternions of opposite sign
    """
    pairs, parts, sigmas = comparison.pairs, comparison.parts, comparison.sigmas
    if pairs and pairs.interpolation_error_rad > FLOOR_SHARE * settings.smallest_limit_rad:
        yield Remark(
            "interpolated",
            f"attitudes were interpolated between samples, which may cause errors of about "
            f"{math.degrees(pairs.interpolation_error_rad):.3g} deg",
        )
    if parts and parts.inclination.max > OPPOSED:
        yield Remark(
            "opposed-verticals",
            "the z axes of A and B point in opposite directions, so a heading error is not "
            "meaningful: is one of them north-east-down and the other east-north-up?",
        )
    exact = comparison.matching.match == "exact"
    if exact and opposite_signs and comparison.worst.error_rad <= SMALL_ERROR:
        yield Remark(
            "opposite-signs",
            f"B has the opposite sign in {opposite_signs} of {count} samples: q and -q are the "
            "same attitude, so this is not an error",
        )
    if sigmas and math.isinf(sigmas.max):
        yield Remark(
            "exact-sigma",
            f"the error at {sigmas.max_ns} ns is infinite in sigma, because sigma is 0 there and "
            "the error is larger than rounding",
        )


def unit(wxyz: Float64) -> Float64:
    """Return unit quaternions: the same array if they already are."""
    off = np.abs(np.sqrt(np.einsum("ij,ij->i", wxyz, wxyz)) - 1) > ROUNDING
    if off.any():
        wxyz = wxyz.copy()
        wxyz[off] = normalize(wxyz[off])
    return wxyz


def _sorted(series: AttitudeSeries, name: str, remarks: list[Remark]) -> tuple[AttitudeSeries, int]:
    """Return unit quaternions in order of time and the number omitted; add remarks.

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
    changes = []
    if backwards:
        times = count_text(backwards, "time")
        changes.append(f"{name} was sorted by time: its timestamps step back {times}")
    if repeated:
        timestamps = f"{count_text(repeated, 'repeated timestamp')} of {name}"
        changes.append(f"{timestamps} omitted, {others} with a different attitude")
    remarks.append(Remark("sorted", "; ".join(changes)))
    return replace(series, wxyz=wxyz)[first], others
