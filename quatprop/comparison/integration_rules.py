"""The integration rule as a mistake: the rates that led to A by one rule, propagated by another."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import aligned_rms
from quatprop.comparison.association import interval_ns
from quatprop.comparison.cause import NO_ERROR
from quatprop.comparison.mistakes import Mistake, Sides, recomposed
from quatprop.kinematics.increments import rotation_vectors
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.settings.choices import METHODS
from quatprop.text import Setting
from quatprop.times import NS_PER_S, duration_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.arrays import Float64, Int64
    from quatprop.series import AttitudeSeries

RULE_ROUNDS = 6
"""Iterations that find the rates of a rule; each gains two orders of the rotation angle."""

MIN_SAMPLES = 20
"""Minimum number of samples that show an integration rule."""

SAME = 2e-3
"""Maximum difference, rad, between A's rotations and those that the rates give back."""

SCREENED = 1_500
"""Number of samples on which rules are tested: those with the most motion."""

AS_GOOD = 2.0
"""Pairs of rules with a residual within this factor of the best are not ruled out: several pairs
differ by one interval, or half of one."""


def integration_rules(sides: Sides) -> Mistake | None:
    """Return the pairs of rules that best explain an error, or None if no rule fits."""
    turns = geodesic_angle(sides.a.wxyz[:-1], sides.a.wxyz[1:])
    sums = np.add.reduceat(turns, np.arange(0, len(turns), SCREENED))
    begin = int(np.argmax(sums)) * SCREENED
    a, b = (series[begin : begin + SCREENED] for series in sides)
    residuals = {}
    for rule in METHODS:
        if (rates := recovered_rates(a, rule)) is None:
            continue
        for other in METHODS:
            if other != rule:
                changed = rates.propagated(other)
                residuals[rule, other] = aligned_rms("mean", changed.wxyz, b.wxyz)
    most = AS_GOOD * min(residuals.values(), default=0.0) + NO_ERROR
    likely = sorted((left, rules) for rules, left in residuals.items() if left <= most)
    return _described([rules for _, rules in likely], a) if likely else None


def _described(likely: Sequence[tuple[str, str]], a: AttitudeSeries) -> Mistake:
    rule, other = likely[0]
    others = " or ".join(dict.fromkeys(pair[1] for pair in likely if pair[0] == rule))
    sentence = f"the same rates lead to A with method {rule}, and to B with method {others}"
    if {rule, other} == {"start", "end"}:
        amount = duration_text(interval_ns(a))
        sentence += f", or their timestamps are one interval, {amount}, apart"
    remedy = "; ".join(
        f"if A was propagated with method {rule}, propagate it with {Setting('method', other)}"
        for rule, other in {pair[0]: pair for pair in reversed(likely)}.values()
    )
    remedy += f"; if B was propagated with method {other}, with {Setting('method', rule)}"

    def undo(sides: Sides) -> Sides:
        rates = recovered_rates(sides.a, rule)
        return sides if rates is None else sides._replace(a=rates.propagated(other))

    return Mistake("method", "another integration rule", sentence, remedy, undo)


class RecoveredRates(NamedTuple):
    """Rates from which attitudes were propagated by a rule.

    `rate`: body rates, shape ``(N, 3)``, rad/s
    `remainder`: the rotations between samples minus those of the rates, shape ``(N - 1, 3)``, rad
    """

    attitudes: AttitudeSeries
    rate: Float64
    remainder: Float64

    @np.errstate(over="ignore", invalid="ignore")  # of rates that grow without bound
    def propagated(self, rule: str) -> AttitudeSeries:
        """Return the attitudes propagated by another rule."""
        steps = rotation_vectors(self.attitudes.t_ns, self.rate, rule)
        return recomposed(self.attitudes, self.remainder + steps)


@np.errstate(over="ignore", invalid="ignore")
def recovered_rates(a: AttitudeSeries, rule: str) -> RecoveredRates | None:
    """Return the rates from which a rule gives A, or None if it cannot."""
    if len(a) < MIN_SAMPLES:
        return None
    steps = rotation_vectors_between(a.wxyz)
    rate = _inverted(a.t_ns, steps, rule)
    remainder = steps - rotation_vectors(a.t_ns, rate, rule)
    if not np.abs(remainder).max() <= SAME:
        return None
    return RecoveredRates(a, rate, remainder)


def _inverted(t_ns: Int64, steps: Float64, rule: str) -> Float64:
    """Return rates, rad/s, from which a rule gives these rotations over intervals, rad.

    For ``start`` and ``end`` they are unique; for others, up to an alternating rate.
    """
    seconds = np.diff(t_ns)[:, None] / NS_PER_S
    mean = steps / seconds
    if rule in {"start", "end"}:
        return np.concatenate([mean, mean[-1:]] if rule == "start" else [mean[:1], mean])
    rate = _from_means(mean)
    for _ in range(0 if rule == "mean" else RULE_ROUNDS):
        correction = rotation_vectors(t_ns, rate, rule) - rotation_vectors(t_ns, rate, "mean")
        rate = _from_means((steps - correction) / seconds)
    return rate


def _from_means(mean: Float64) -> Float64:
    """Return the smoothest values of which neighbours have these means."""
    sign = np.where(np.arange(len(mean) + 1) % 2, -1.0, 1.0)[:, None]
    values = np.zeros((len(mean) + 1, 3))
    np.cumsum(-2 * sign[:-1] * mean, axis=0, out=values[1:])
    values *= sign
    alternating = (sign[:-1] * np.diff(values, axis=0)).mean(axis=0) / 2
    return np.asarray(values + sign * alternating)
