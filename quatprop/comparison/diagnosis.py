"""The likely cause of an error.

Mistakes in reading, propagating and timing are recognised by the rotations over short windows,
which frames, biases and slow drift do not change. What remains is explained by the errors
themselves: a reference frame, a bias or a drift is reported only if less than a tenth of the error
remains without it. Series of the same stamps may differ by the integration rules that led from the
same samples to A and to B: pairs of them are tried out first.
"""

from __future__ import annotations

from contextlib import suppress
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.association import associate, interval_ns, shifted
from quatprop.comparison.cause_sentences import described
from quatprop.comparison.hypotheses import (
    EXACT,
    Cause,
    aligned_rms,
    causes_of_errors,
    isolated_samples,
)
from quatprop.comparison.trials import ClockError, Trial, rms_length, trials
from quatprop.comparison.window_trials import CLOCKS, MISTAKES, WindowTrials
from quatprop.comparison.windows import common_beginning, undone_misreadings, window_grids
from quatprop.errors import ComparisonError
from quatprop.kinematics.increments import rotation_vectors
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.series.blocks import rms
from quatprop.settings.choices import METHODS
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from quatprop.arrays import Float64, Int64
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.series import AttitudeSeries

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

BOUNDED = 1e100
"""rad: rates that lead to more grow without bound, and are no candidates."""

FRAMES_COME_FIRST = {"method", "scale"}
"""Mistakes that turn no reference frame: where frames differ too, that comes first."""

METHOD_SAMPLES = 5_000
"""Samples from which the integration rules are compared."""

MIN_METHOD_SAMPLES = 20
"""Fewer samples do not show an integration rule."""

DETERMINED = ("start", "end")
"""Rules under which the rotations determine the rates."""

RULE_ROUNDS = 6
"""Rounds in which rates are found for a rule; each gains two orders of the rotation."""

ZIGZAG_ROUNDS = 3
"""Rounds of least squares for the alternating rate that such a rule leaves open."""

ZIGZAG_SHARE = 1e-3
"""Change of that rate, as a share of all, from which a slope is taken."""

INNER = slice(2, -3)
"""Intervals by which rules are compared: the rates at the ends are not determined."""


def likely_cause(
    a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings, error: Float64
) -> Cause | None:
    """Return what explains an error, if something does.

    Of a long recording the first part is looked at, but all of it for isolated samples.

    `error`: the errors after that, rad, shape ``(N,)``, in rising order
    """
    if len(error) < MIN_PAIRS or rms(error) <= NO_ERROR:
        return None
    outliers = isolated_samples(error)
    if outliers and outliers.rms_after <= outliers.rms_before / FACTOR:
        return outliers
    a, b = common_beginning(a, b)
    if len(a) < MIN_PAIRS or len(b) < MIN_PAIRS:
        return None
    names = MISTAKES - {"body frame"} if settings.align == "mount" else MISTAKES
    mistake, clock = _cause_over_windows(a, b, names)
    if mistake and clock:
        first_ns = min(int(a.t_ns[0]), int(b.t_ns[0]))
        seconds = clock.at((b.t_ns - first_ns) / NS_PER_S)
        moved = shifted(b, np.rint(seconds * NS_PER_S).astype(np.int64))
        before, after = (_total(a, other, settings) for other in (b, moved))
        mistake = mistake._replace(total_before=before, total_after=after)
    gross = (
        mistake and mistake.rms_after <= GROSS * mistake.rms_before and not mistake.leaves(GROSS)
    )
    if gross and mistake and mistake.name not in FRAMES_COME_FIRST:
        return mistake
    main = _cause_of_errors(a, b, settings)
    if main is None or (gross and main.name != "reference frame"):
        return mistake
    return main._replace(also=mistake)


def _total(a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings) -> float | None:
    """Return the RMS error, rad; None where the series cannot be compared."""
    with suppress(ComparisonError):
        pairs = associate(a, b, settings)
        return aligned_rms(settings.align, pairs.a, pairs.b)
    return None


def _cause_over_windows(
    a: AttitudeSeries, b: AttitudeSeries, names: Collection[str]
) -> tuple[Cause | None, ClockError | None]:
    """Return the mistake that rotations over windows show, and the clock error if it is one."""
    if cause := _method_cause(a, b):
        return cause, None
    angles = list(undone_misreadings(a, b))
    lengths = [
        WindowTrials(length, starts, angles[0], list(trials(angles, starts, length)))
        for length, starts in window_grids(angles[0].a.seconds, angles[0].b.seconds)
    ]
    if not lengths:
        return None, None
    intervals = [interval_ns(series) / NS_PER_S for series in (a, b)]
    clearest = min(lengths, key=lambda windows: windows.unexplained)
    found = clearest.found(min(intervals), names)
    if found is None:
        # A time offset stands out most clearly elsewhere: it matters more the faster rates change.
        clearest = min(lengths, key=lambda windows: windows.offset_std)
        found = clearest.found(min(intervals), CLOCKS)
    if found is None:
        return None, None
    trial, alternatives = found
    name, sentence, remedy = described(trial, alternatives, intervals)
    window_ns = round(clearest.length * NS_PER_S)
    cause = Cause(name, sentence, clearest.before.rms, trial.rms, remedy, window_ns)
    return cause, trial.value if isinstance(trial.value, ClockError) else None


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
    interval = interval_ns(a)
    name, sentence, remedy = described(best, [], [interval / NS_PER_S] * 2)
    return Cause(name, sentence, before.rms, best.rms, remedy, interval)


def _cause_of_errors(
    a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings
) -> Cause | None:
    """Return what explains nearly all of the errors: a frame, a bias or a drift."""
    try:
        pairs = associate(a, b, settings)
        before = aligned_rms(settings.align, pairs.a, pairs.b)
    except ComparisonError:
        return None
    if len(pairs) < MIN_PAIRS or before <= NO_ERROR:
        return None
    causes = list(causes_of_errors(pairs, settings.align, before))
    best = min((cause.rms_after for cause in causes), default=before)
    if best > before / FACTOR:
        return None
    limit = min(max(AS_GOOD * best, EXACT), before / FACTOR)
    return next(cause for cause in causes if cause.rms_after <= limit)


def method_trials(a: AttitudeSeries, b: AttitudeSeries) -> Iterator[Trial]:
    """Try pairs of integration rules on series of the same stamps, over single intervals.

    The rates that a rule would need to arrive at one series are propagated by the other rules, and
    the rotations over the intervals compared with those of the other series.
    """
    count = min(len(a), len(b), METHOD_SAMPLES)
    t_ns = a.t_ns[:count]
    if count < MIN_METHOD_SAMPLES or not np.array_equal(t_ns, b.t_ns[:count]):
        return
    of_a, of_b = (rotation_vectors_between(series.wxyz[:count]) for series in (a, b))
    yield Trial("", (of_a - of_b)[INNER])
    # Rules come in the order in which their rates are found more and more indirectly.
    for known, other in combinations(METHODS, 2):
        yield Trial("method", _after_rules(t_ns, of_a, of_b, known, other), value=(known, other))
        yield Trial("method", _after_rules(t_ns, of_b, of_a, known, other), value=(other, known))


@np.errstate(over="ignore", invalid="ignore")  # of rates that grow without bound
def _after_rules(t_ns: Int64, known: Float64, sought: Float64, rule: str, other: str) -> Float64:
    """Return rotations by `other` less those sought, for rates that give the known by `rule`."""
    zigzag = np.zeros(3)

    def remaining(zigzag: Float64) -> Float64:
        rate = _rates(t_ns, known, rule, zigzag)
        values = np.asarray(rotation_vectors(t_ns, rate, other) - sought)[INNER]
        return values if np.all(np.abs(values) < BOUNDED) else np.full_like(values, np.inf)

    best = remaining(zigzag)
    if rule in DETERMINED or not np.isfinite(best).all():
        return best
    small = ZIGZAG_SHARE * max(rms_length(known) / float(np.diff(t_ns).mean()) * NS_PER_S, 1e-9)
    for _ in range(ZIGZAG_ROUNDS):
        slopes = [((remaining(zigzag + small * axis) - best) / small).ravel() for axis in np.eye(3)]
        if not np.isfinite(slopes).all():
            break
        step, *_ = np.linalg.lstsq(np.stack(slopes, axis=1), -best.ravel(), rcond=None)
        moved = remaining(zigzag + step)
        if not rms_length(moved) < rms_length(best):
            break
        zigzag, best = zigzag + step, moved
    return best


def _rates(t_ns: Int64, steps: Float64, rule: str, zigzag: Float64) -> Float64:
    """Return rates, rad/s, from which a rule arrives at the rotations over intervals, rad.

    Those of ``start`` and ``end`` are determined. To others, an alternating rate can be added.
    """
    seconds = np.diff(t_ns)[:, None] / NS_PER_S
    mean = steps / seconds
    if rule in DETERMINED:
        return np.concatenate([mean, mean[-1:]] if rule == "start" else [mean[:1], mean])
    rate = _from_means(mean, zigzag)
    for _ in range(0 if rule == "mean" else RULE_ROUNDS):
        beyond = rotation_vectors(t_ns, rate, rule) - rotation_vectors(t_ns, rate, "mean")
        rate = _from_means((steps - beyond) / seconds, zigzag)
    return rate


def _from_means(mean: Float64, zigzag: Float64) -> Float64:
    """Return the smoothest values whose neighbours have these means, and an alternating one."""
    sign = np.where(np.arange(len(mean) + 1) % 2, -1.0, 1.0)[:, None]
    values = np.zeros((len(mean) + 1, 3))
    np.cumsum(-2 * sign[:-1] * mean, axis=0, out=values[1:])
    values *= sign
    alternating = (sign[:-1] * np.diff(values, axis=0)).mean(axis=0) / 2
    return np.asarray(values + sign * (alternating + zigzag))
