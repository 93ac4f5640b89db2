"""The likely cause of an error.

Mistakes in reading, propagating and timing are recognised by the rotations over short windows,
which frames, biases and slow drift do not change. What remains is explained by the errors
themselves: a reference frame, a bias or a drift is reported only if less than a tenth of the error
remains without it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.cause_sentences import described
from quatprop.comparison.hypotheses import (
    EXACT,
    FRAME_AND_BIAS,
    constant_rotations,
    isolated_samples,
    rate_biases,
    remaining_errors,
    steady_drifts,
)
from quatprop.comparison.rule_trials import method_trials
from quatprop.comparison.statistics import NS_PER_S, rms
from quatprop.comparison.trials import ClockDrift, TimeOffset, trials
from quatprop.comparison.window_trials import WindowTrials
from quatprop.comparison.windows import common_beginning, undone_misreadings, window_grids
from quatprop.errors import ComparisonError
from quatprop.text import Text

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.arrays import Float64
    from quatprop.comparison.association import Pairs
    from quatprop.series import AttitudeSeries
    from quatprop.text import Setting


FACTOR = 10.0
"""Without a cause found in the errors themselves, at most the error over this remains."""

AS_GOOD = 3.0
"""Such causes within this factor of the best are as good: the simplest is reported."""

NO_ERROR = 1e-9
"""RMS error, rad, that needs no explanation."""

MIN_PAIRS = 10
"""Fewer pairs can be explained by almost anything."""

MAX_REMAINING_METHOD = 0.02
"""The same for integration rules: from the same samples, all that remains is rounding."""

GROSS = 0.5
"""A mistake that leaves less than this comes before causes found in the errors themselves."""

CLOCKS = ("time offset", "clock drift")
"""Mistakes in timestamps, which matter more the faster rates change."""

SMALL = {"method", "scale"}
"""Mistakes that turn no reference frame: where frames differ too, that comes first."""


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
        The setting that takes the error out of the comparison, or with which to read or propagate.
    window_ns
        Where the cause was found in rotations over windows, their length, ns: the RMS errors are
        those of the rotations, less a constant rate. None: they are those of the attitudes.
    also
        A second cause, of which the first hides the effect.
    total_before, total_after
        RMS errors of the attitudes without and with the explanation, rad, where it was found in
        rotations over windows and they are known.
    """

    name: str
    sentence: str
    rms_before: float
    rms_after: float
    remedy: Setting | Text | None = None
    window_ns: int | None = None
    also: Cause | None = None
    total_before: float | None = None
    total_after: float | None = None

    @property
    def advice(self) -> Text:
        """The sentence with the remedy; not for a regression, which the remedy would hide."""
        return (
            Text(self.sentence) if self.remedy is None else Text(self.sentence, "; ", self.remedy)
        )


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
        The errors after that, rad, shape ``(N,)``, in rising order.
    """
    if len(error) < MIN_PAIRS or rms(error) <= NO_ERROR:
        return None
    for outliers in isolated_samples(error):
        if rms(outliers.remaining) <= rms(error) / FACTOR:
            return Cause(outliers.name, outliers.sentence, rms(error), rms(outliers.remaining))
    a, b = common_beginning(a, b)
    if len(a) < MIN_PAIRS or len(b) < MIN_PAIRS:
        return None

    first_ns = min(int(a.t_ns[0]), int(b.t_ns[0]))

    def total(clock: TimeOffset | ClockDrift | None) -> float | None:
        """Return the RMS error with what a clock is off by added to B's stamps."""
        moved = b
        if clock is not None:
            seconds = clock.at((b.t_ns - first_ns) / NS_PER_S)
            moved = replace(b, t_ns=b.t_ns + np.rint(seconds * NS_PER_S).astype(np.int64))
        try:
            pairs = match(a, moved)
        except ComparisonError:
            return None
        errors = remaining_errors(pairs, alignment, pairs.b)
        return None if errors is None else rms(errors)

    mistake = _cause_over_windows(a, b, total, turned=alignment != "mount")
    gross = mistake and mistake.rms_after <= GROSS * mistake.rms_before and not _is_minor(mistake)
    if gross and mistake and mistake.name not in SMALL:
        return mistake
    main = _cause_of_errors(a, b, match, alignment)
    if gross and (main is None or main.name != "reference frame"):
        return mistake
    return replace(main, also=mistake) if main else mistake


def _is_minor(cause: Cause) -> bool:
    """Tell whether most of the error of the attitudes has another cause."""
    if cause.total_before is None or cause.total_after is None:
        return False
    return cause.total_after > GROSS * cause.total_before


def _cause_over_windows(
    a: AttitudeSeries,
    b: AttitudeSeries,
    total: Callable[[TimeOffset | ClockDrift | None], float | None],
    *,
    turned: bool,
) -> Cause | None:
    """Return the mistake that the rotations over windows show."""
    if cause := _method_cause(a, b):
        return cause
    angles = list(undone_misreadings(a, b))
    lengths = [
        WindowTrials(length, starts, angles[0], list(trials(angles, starts, length)))
        for length, starts in window_grids(angles[0].a.seconds, angles[0].b.seconds)
    ]
    if not lengths:
        return None
    clearest = min(lengths, key=lambda windows: windows.unexplained)
    intervals = [float(np.median(np.diff(series.t_ns))) / NS_PER_S for series in (a, b)]
    found = clearest.found(min(intervals), turned=turned)
    if found is None:
        # A time offset stands out most clearly elsewhere: it matters more the faster rates change.
        clearest = min(lengths, key=lambda windows: windows.offset_std)
        found = clearest.found(min(intervals), turned=turned, only=CLOCKS)
    if found is None:
        return None
    trial, alternatives = found
    name, sentence, remedy = described(trial, alternatives, intervals)
    window_ns = round(clearest.length * NS_PER_S)
    cause = Cause(name, sentence, clearest.before.rms, trial.rms, remedy, window_ns)
    if isinstance(trial.value, TimeOffset | ClockDrift):
        cause = replace(cause, total_before=total(None), total_after=total(trial.value))
    return cause


def _method_cause(a: AttitudeSeries, b: AttitudeSeries) -> Cause | None:
    """Return the integration rules that turn A into B to rounding, if some do."""
    tried = list(method_trials(a, b))
    if not tried or tried[0].rms <= NO_ERROR:
        return None
    before, *tried = tried
    # Rates that grow without bound where a rule cannot have led to the series are no candidates.
    best = min(tried, key=lambda trial: trial.rms if np.isfinite(trial.rms) else np.inf)
    if not best.rms <= MAX_REMAINING_METHOD * before.rms:
        return None
    interval = float(np.median(np.diff(a.t_ns)))
    name, sentence, remedy = described(best, [], [interval / NS_PER_S] * 2)
    return Cause(name, sentence, before.rms, best.rms, remedy, round(interval))


def _cause_of_errors(
    a: AttitudeSeries,
    b: AttitudeSeries,
    match: Callable[[AttitudeSeries, AttitudeSeries], Pairs],
    alignment: str,
) -> Cause | None:
    """Return what explains nearly all of the errors: a frame, a bias or a drift."""
    try:
        pairs = match(a, b)
    except ComparisonError:
        return None
    now = remaining_errors(pairs, alignment, pairs.b)
    if len(pairs) < MIN_PAIRS or now is None or (before := rms(now)) <= NO_ERROR:
        return None
    hypotheses = [
        *constant_rotations(pairs, alignment),
        *rate_biases(pairs, alignment),
        *steady_drifts(pairs, alignment),
    ]
    after = [rms(hypothesis.remaining) for hypothesis in hypotheses]
    best = min(after, default=before)
    if best > before / FACTOR:
        return None
    limit = min(max(AS_GOOD * best, EXACT), before / FACTOR)
    chosen = next(place for place, remaining in enumerate(after) if remaining <= limit)
    cause = hypotheses[chosen]
    what = "the frames" if cause.name == FRAME_AND_BIAS else "it"
    remedy = cause.remedy and Text(cause.remedy, f" takes {what} out")
    return Cause(cause.name, cause.sentence, before, after[chosen], remedy)
