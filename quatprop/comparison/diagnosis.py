"""The likely cause of an error.

A hypothesis is reported only if less than a tenth of the error remains without its mistake; of
several that do about equally well, the simplest, which is tried first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.hypotheses import (
    EXACT,
    frame_rotations,
    isolated_samples,
    misreadings,
    propagations,
    remaining_errors,
    steady_drifts,
    time_offsets,
    with_reference_aligned,
)
from quatprop.comparison.statistics import rms
from quatprop.errors import ComparisonError
from quatprop.series import AttitudeSeries
from quatprop.text import Text

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from quatprop.comparison.association import Pairs
    from quatprop.text import Setting

    Float64 = NDArray[np.float64]

FACTOR = 10.0
"""Without its likely cause, at most the error over this remains."""

AS_GOOD = 3.0
"""Hypotheses within this factor of the best are as good: the simplest is reported."""

NO_ERROR = 1e-9
"""RMS error, rad, that needs no explanation."""

MAX_SAMPLES = 100_000
"""Samples of either series, from the start, in which causes are looked for."""

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
    remedy
        The setting that takes the error out of the comparison, where one does.
    """

    name: str
    sentence: str
    rms_before: float
    rms_after: float
    remedy: Setting | None = None

    @property
    def advice(self) -> Text:
        """The sentence with the remedy; not for a regression, which the remedy would hide."""
        if self.remedy is None:
            return Text(self.sentence)
        return Text(self.sentence, "; ", self.remedy, " takes it out")


def likely_cause(
    a: AttitudeSeries,
    b: AttitudeSeries,
    match: Callable[[AttitudeSeries, AttitudeSeries], Pairs],
    alignment: str,
    error: Float64,
) -> Cause | None:
    """Return what explains an error, if something does.

    Of a long recording the first part is looked at, but all of it for isolated samples.

    Parameters
    ----------
    a, b
        The series, B in A's clock as far as that is known.
    match
        Matches them in time.
    alignment
        How they were aligned: one of :data:`quatprop.comparison.settings.ALIGNMENTS`.
    error
        The errors after that, rad, shape ``(N,)``.
    """
    if len(error) < MIN_PAIRS or rms(error) <= NO_ERROR:
        return None
    for outliers in isolated_samples(error):
        if rms(outliers.remaining) <= rms(error) / FACTOR:
            return Cause(outliers.name, outliers.sentence, rms(error), rms(outliers.remaining))
    a, b = (_first_samples(series) for series in _from_common_start(a, b))
    try:
        pairs = match(a, b)
    except ComparisonError:
        return None
    now = remaining_errors(pairs, alignment, pairs.b)
    if len(pairs) < MIN_PAIRS or now is None or (before := rms(now)) <= NO_ERROR:
        return None
    hypotheses = [
        *misreadings(pairs, alignment),
        *frame_rotations(pairs, alignment),
        *propagations(pairs, alignment),
        *time_offsets(a, b, alignment, match),
        *steady_drifts(pairs, alignment),
        *with_reference_aligned(pairs, alignment),
    ]
    after = [rms(hypothesis.remaining) for hypothesis in hypotheses]
    best = min(after, default=before)
    if best > before / FACTOR:
        return None
    limit = min(max(AS_GOOD * best, EXACT), before / FACTOR)
    chosen = next(place for place, remaining in enumerate(after) if remaining <= limit)
    cause = hypotheses[chosen]
    return Cause(cause.name, cause.sentence, before, after[chosen], cause.remedy)


def _from_common_start(
    a: AttitudeSeries, b: AttitudeSeries
) -> tuple[AttitudeSeries, AttitudeSeries]:
    """Return both series without what one of them has before the other one begins."""
    start = max(a.t_ns[0], b.t_ns[0])
    first_a, first_b = (max(int(np.searchsorted(s.t_ns, start)) - 1, 0) for s in (a, b))
    return _part(a, slice(first_a, None)), _part(b, slice(first_b, None))


def _first_samples(series: AttitudeSeries) -> AttitudeSeries:
    return _part(series, slice(MAX_SAMPLES))


def _part(series: AttitudeSeries, rows: slice) -> AttitudeSeries:
    return AttitudeSeries(series.t_ns[rows], series.wxyz[rows])
