"""What may explain an error.

A hypothesis is reported only if it leaves less than a tenth of the error; of several that do about
equally well, the simplest, which is tried first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.hypotheses import (
    EXACT,
    drifting,
    errors_left,
    isolated,
    late,
    misread,
    multiplied,
    turned,
    with_free_reference,
)
from quatprop.comparison.statistics import rms
from quatprop.errors import ComparisonError
from quatprop.series import AttitudeSeries

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from quatprop.comparison.association import Pairs

    Float64 = NDArray[np.float64]

FACTOR = 10.0
"""An explanation leaves at most the error over this."""

AS_GOOD = 3.0
"""Explanations within this factor of the best are as good: the simplest is named."""

NO_ERROR = 1e-9
"""RMS error, rad, that needs no explanation."""

EXPLAINED = 100_000
"""Samples of either series in which causes are looked for."""

MIN_PAIRS = 10
"""Fewer pairs can be explained by almost anything."""


@dataclass(frozen=True, slots=True)
class Cause:
    """What explains most of an error.

    Parameters
    ----------
    name
        A short name, stable for scripts.
    sentence
        What it means.
    rms_before, rms_after
        RMS error without and with the explanation, rad.
    """

    name: str
    sentence: str
    rms_before: float
    rms_after: float


def likely_cause(
    a: AttitudeSeries,
    b: AttitudeSeries,
    associated: Callable[[AttitudeSeries, AttitudeSeries], Pairs],
    alignment: str,
    error: Float64,
) -> Cause | None:
    """Return what explains an error, if something does.

    Of a long recording the first part is looked at, but all of it for isolated samples.

    Parameters
    ----------
    a, b
        The series as they were read, B in A's clock as far as it is known.
    associated
        Brings them together.
    alignment
        How they were aligned: a name of :data:`quatprop.comparison.alignment.ALIGNMENTS`.
    error
        The errors after that, rad, shape ``(N,)``.
    """
    if len(error) < MIN_PAIRS or rms(error) <= NO_ERROR:
        return None
    for tried in isolated(error):
        if rms(tried.error) <= rms(error) / FACTOR:
            return Cause(tried.name, tried.sentence, rms(error), rms(tried.error))
    a, b = (_first_part(series) for series in _from_the_same_time(a, b))
    try:
        pairs = associated(a, b)
    except ComparisonError:
        return None
    now = errors_left(pairs, alignment, pairs.b)
    if len(pairs) < MIN_PAIRS or now is None or (before := rms(now)) <= NO_ERROR:
        return None
    every = [
        *misread(pairs, alignment),
        *turned(pairs, alignment),
        *multiplied(pairs, alignment),
        *late(a, b, alignment, associated),
        *drifting(pairs, alignment),
        *with_free_reference(pairs, alignment),
    ]
    left = [rms(tried.error) for tried in every]
    best = min(left, default=before)
    if best > before / FACTOR:
        return None
    limit = min(max(AS_GOOD * best, EXACT), before / FACTOR)
    tried, after = next(pair for pair in zip(every, left, strict=True) if pair[1] <= limit)
    return Cause(tried.name, tried.sentence, before, after)


def _from_the_same_time(
    a: AttitudeSeries, b: AttitudeSeries
) -> tuple[AttitudeSeries, AttitudeSeries]:
    """Return both series without what one of them has before the other one begins."""
    start = max(a.t_ns[0], b.t_ns[0])
    first_a, first_b = (max(int(np.searchsorted(s.t_ns, start)) - 1, 0) for s in (a, b))
    return _part(a, slice(first_a, None)), _part(b, slice(first_b, None))


def _first_part(series: AttitudeSeries) -> AttitudeSeries:
    return _part(series, slice(EXPLAINED))


def _part(series: AttitudeSeries, rows: slice) -> AttitudeSeries:
    return AttitudeSeries(series.t_ns[rows], series.wxyz[rows])
