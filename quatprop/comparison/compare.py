"""Compare two attitude series: match them in time, align them, measure the error."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.alignment import align
from quatprop.comparison.association import associate, shifted
from quatprop.comparison.clocks import find_offset
from quatprop.comparison.criteria import coverage, judge
from quatprop.comparison.diagnosis import likely_cause
from quatprop.comparison.result import AppliedOffset, ComparedSample, Comparison, Matching
from quatprop.comparison.settings import ComparisonSettings
from quatprop.comparison.sigmas import sigma_statistics
from quatprop.comparison.statistics import (
    drift_deg_h,
    error_statistics,
    geodesic_errors,
    window_statistics,
)
from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import normalize
from quatprop.series import AttitudeSeries, blocks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from quatprop.comparison.association import Pairs

    Float64 = NDArray[np.float64]

UNIT_LENGTH = 1e-3
"""Difference from unit length that is remarked on; decimals of a text file stay below it."""

ROUNDING = 1e-14
"""Difference from unit length below which quaternions are compared as they are, without a copy."""

SMALL = 0.5
"""Error, rad, below which it makes sense to compare the signs of quaternions."""


def compare(
    a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings | None = None
) -> Comparison:
    """Measure the geodesic error between two attitude series.

    Parameters
    ----------
    a, b
        The series. They are sorted by time and normalised.
    settings
        How to compare; None: all defaults.

    Raises
    ------
    ComparisonError
        The series cannot be compared: too few pairs, no motion to align by...
    UsageError
        There is no such alignment or match.

    Examples
    --------
    >>> t_ns = np.arange(3) * 10_000_000
    >>> a = AttitudeSeries(t_ns, np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)))
    >>> b = AttitudeSeries(t_ns, -a.wxyz)
    >>> compare(a, b).error_rad.max
    0.0
    """
    settings = settings or ComparisonSettings()
    remarks: list[str] = []
    a, b = _sorted(a, "A", remarks), _sorted(b, "B", remarks)
    offset = _offset(a, b, settings)
    b = shifted(b, offset.added_to_b_ns)
    match = partial(
        associate,
        match=settings.match,
        max_dt_ns=settings.max_dt,
        min_matched=settings.min_matched / 100,
    )
    pairs = match(a, b)
    alignment = align(settings.align, pairs.a, pairs.b)
    errors, opposite = geodesic_errors(pairs, alignment)
    sample = partial(_sample, pairs, errors)
    if pairs.match == "exact" and opposite and errors.max() <= SMALL:
        remarks.append(
            f"B has the opposite sign in {opposite} of {len(pairs)} samples: q and -q are the "
            "same attitude, so this is no error"
        )
    window = None
    if settings.window:
        window = window_statistics(pairs.t_ns, pairs.a, alignment.apply(pairs.b), settings.window)
    statistics, drift = error_statistics(errors), drift_deg_h(pairs.t_ns, errors)
    covered = coverage(pairs, b)
    sigmas = sigma_statistics(a, b, pairs, alignment)
    criteria = tuple(judge(settings, statistics, window, drift, covered, sigmas))
    passed = all(criterion.passed for criterion in criteria)
    limit = np.inf if settings.tol is None else settings.tol
    above = statistics.max > limit
    explain = not (criteria and passed)
    return Comparison(
        t_ns=pairs.t_ns,
        errors=errors,
        association=_matching(pairs),
        time_offset=offset,
        alignment=alignment,
        error_rad=statistics,
        drift_deg_h=drift,
        worst=sample(int(np.argmax(errors))),
        window=window,
        sigmas=sigmas,
        coverage=covered,
        tolerance_rad=settings.tol,
        criteria=criteria,
        passed=passed,
        first_exceeding=sample(int(np.argmax(errors > limit))) if above else None,
        likely_cause=likely_cause(a, b, match, settings.align, errors) if explain else None,
        remarks=tuple(remarks),
    )


def _offset(a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings) -> AppliedOffset:
    if settings.time_offset == "auto":
        found = find_offset(a, b)
        return AppliedOffset(found.ns, found)
    return AppliedOffset(settings.time_offset, None)


def _sorted(series: AttitudeSeries, name: str, remarks: list[str]) -> AttitudeSeries:
    """Return a series of unit quaternions at rising stamps; add remarks on what was changed."""
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
            f"{name} has {invalid} of {len(series)} rows that are no attitude (zero or not a "
            f"number), the first at index {first_invalid}; leave them out"
        )
    if deviation > UNIT_LENGTH:
        remarks.append(f"{name} is not of unit length, by up to {deviation:.2g}; normalised")
    t_ns, wxyz = series.t_ns, series.wxyz
    if deviation > ROUNDING:
        wxyz = np.empty_like(series.wxyz)
        for rows in blocks(len(wxyz)):
            wxyz[rows] = normalize(series.wxyz[rows])
    intervals = np.diff(t_ns)
    if (intervals > 0).all():
        return replace(series, wxyz=wxyz)
    _, first = np.unique(t_ns, return_index=True)
    backwards, repeated = int((intervals < 0).sum()), len(t_ns) - len(first)
    remarks.append(
        f"{name} was sorted by time: its timestamps step back {backwards} times, and {repeated} "
        "repeated ones were left out"
    )
    return replace(series, wxyz=wxyz)[first]


def _matching(pairs: Pairs) -> Matching:
    return Matching(
        match=pairs.match,
        at=pairs.at,
        max_dt_ns=pairs.max_dt_ns,
        matched=len(pairs),
        candidates=pairs.candidates,
        first_ns=int(pairs.t_ns[0]),
        last_ns=int(pairs.t_ns[-1]),
    )


def _sample(pairs: Pairs, errors: Float64, pair: int) -> ComparedSample:
    return ComparedSample(
        int(pairs.t_ns[pair]), pairs.at, int(pairs.index[pair]), float(errors[pair])
    )
