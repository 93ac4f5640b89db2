"""Pairs of integration rules by which the same samples may have led to A and to B."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.trials import Trial, size
from quatprop.kinematics.increments import METHODS, rotation_vectors
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64, Int64
    from quatprop.series import AttitudeSeries


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
        remaining = _after_rules(t_ns, of_a, of_b, known, other)
        yield Trial("method", remaining, value=(known, other))
        remaining = _after_rules(t_ns, of_b, of_a, known, other)
        yield Trial("method", remaining, value=(other, known))


def _after_rules(t_ns: Int64, known: Float64, sought: Float64, rule: str, other: str) -> Float64:
    """Return what remains of rotations by `other` where rates by `rule` lead to the known ones."""
    zigzag = np.zeros(3)

    def remaining(zigzag: Float64) -> Float64:
        rate = _rates(t_ns, known, rule, zigzag)
        return np.asarray(rotation_vectors(t_ns, rate, other) - sought)[INNER]

    best = remaining(zigzag)
    if rule in DETERMINED or not np.isfinite(best).all():
        return best
    small = ZIGZAG_SHARE * max(size(known) / float(np.diff(t_ns).mean()) * NS_PER_S, 1e-9)
    for _ in range(ZIGZAG_ROUNDS):
        slopes = [((remaining(zigzag + small * axis) - best) / small).ravel() for axis in np.eye(3)]
        step, *_ = np.linalg.lstsq(np.stack(slopes, axis=1), -best.ravel(), rcond=None)
        moved = remaining(zigzag + step)
        if not size(moved) < size(best):
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
