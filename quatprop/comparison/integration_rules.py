"""The integration rule as a mistake: the rates that led to A by one rule, propagated by another."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import align
from quatprop.comparison.association import interval_ns
from quatprop.comparison.cause import NO_ERROR
from quatprop.comparison.undoing import Sides, Undoing, recomposed
from quatprop.kinematics.increments import rotation_vectors
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.series.blocks import rms
from quatprop.settings.choices import METHODS
from quatprop.text import Setting
from quatprop.times import NS_PER_S, duration_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.arrays import Float64, Int64
    from quatprop.series import AttitudeSeries

RULE_ROUNDS = 6
"""Rounds in which rates are found for a rule; each gains two orders of the rotation."""

MIN_SAMPLES = 20
"""Fewer samples do not show an integration rule."""

ROUGH = 40.0
"""Squared changes of rates over those of their means: of noise 4; others grow without bound."""

SAME = 2e-3
"""rad: the rates must lead back to A; what is missing of that is missing with the other rule."""


SCREENED = 1_500
"""Samples from which the rules are told: those with the most motion."""

MOST = 0.5
"""Share of the error over which a rule must be able to lead away to be tried."""

AS_GOOD = 2.0
"""Pairs of rules that leave less than this much more than the best explain the error as well: what
several of them differ by is an interval, or half of one."""


def integration_rules(sides: Sides) -> Undoing | None:
    """Return the pairs of rules that explain most of an error, if any can."""
    turns = geodesic_angle(sides.a.wxyz[:-1], sides.a.wxyz[1:])
    sums = np.add.reduceat(turns, np.arange(0, len(turns), SCREENED))
    begin = int(np.argmax(sums)) * SCREENED
    a, b = (series[begin : begin + SCREENED] for series in sides)
    before = rms(geodesic_angle(a.wxyz, align("mean", a.wxyz, b.wxyz).apply(b.wxyz)))
    tried = {}
    for known in METHODS:
        if (rates := led_by(a, known)) is None:
            continue
        for other in METHODS:
            if other != known:
                if rates.most(other) < MOST * before:
                    continue
                changed = rates.propagated(other)
                aligned = align("mean", changed.wxyz, b.wxyz).apply(b.wxyz)
                tried[known, other] = rms(geodesic_angle(changed.wxyz, aligned))
    most = AS_GOOD * min(tried.values(), default=0.0) + NO_ERROR
    likely = sorted((left, rules) for rules, left in tried.items() if left <= most)
    return _described([rules for _, rules in likely], a) if likely else None


def _described(likely: Sequence[tuple[str, str]], a: AttitudeSeries) -> Undoing:
    known, other = likely[0]
    sentence = f"the same rates lead to A with method {known}, and to B with method {other}"
    if {known, other} == {"start", "end"}:
        amount = duration_text(interval_ns(a))
        sentence += f", or their timestamps are one interval, {amount}, apart"
    remedy = "; ".join(
        f"if A was propagated with method {known}, propagate it with {Setting('method', other)}"
        for known, other in {known: (known, other) for known, other in reversed(likely)}.values()
    )
    remedy += f"; if B was propagated with method {other}, with {Setting('method', known)}"

    def apply(sides: Sides) -> Sides:
        rates = led_by(sides.a, known)
        return sides if rates is None else sides._replace(a=rates.propagated(other))

    return Undoing("method", "another integration rule", sentence, remedy, apply)


class Rates(NamedTuple):
    """Rates, rad/s, that led to attitudes, shape ``(N, 3)``.

    `beyond`: what the rotations from sample to sample are more than those that the rates give back,
        rad, shape ``(N - 1, 3)``
    """

    attitudes: AttitudeSeries
    rate: Float64
    beyond: Float64

    def most(self, rule: str) -> float:
        """Return how far another rule can lead from these attitudes at most, rad."""
        steps = rotation_vectors(self.attitudes.t_ns, self.rate, rule)
        change = self.beyond + steps - rotation_vectors_between(self.attitudes.wxyz)
        return float(np.linalg.norm(change, axis=1).sum())

    @np.errstate(over="ignore", invalid="ignore")  # of rates that grow without bound
    def propagated(self, rule: str) -> AttitudeSeries:
        """Return where the rates lead to by another rule."""
        steps = rotation_vectors(self.attitudes.t_ns, self.rate, rule)
        return recomposed(self.attitudes, self.beyond + steps)


@np.errstate(over="ignore", invalid="ignore")
def led_by(a: AttitudeSeries, rule: str) -> Rates | None:
    """Return the rates that led to A by a rule, if there can be any."""
    if len(a) < MIN_SAMPLES:
        return None
    steps = rotation_vectors_between(a.wxyz)
    mean = steps / (np.diff(a.t_ns)[:, None] / NS_PER_S)
    rate = _rates(a.t_ns, steps, rule)
    rough, smooth = (float(np.square(np.diff(one, axis=0)).sum()) for one in (rate, mean))
    beyond = steps - rotation_vectors(a.t_ns, rate, rule)
    if not (rough <= ROUGH * smooth and np.abs(beyond).max() <= SAME):
        return None
    return Rates(a, rate, beyond)


def _rates(t_ns: Int64, steps: Float64, rule: str) -> Float64:
    """Return rates, rad/s, from which a rule arrives at the rotations over intervals, rad.

    Those of ``start`` and ``end`` are determined. To others, an alternating rate can be added.
    """
    seconds = np.diff(t_ns)[:, None] / NS_PER_S
    mean = steps / seconds
    if rule in {"start", "end"}:
        return np.concatenate([mean, mean[-1:]] if rule == "start" else [mean[:1], mean])
    rate = _from_means(mean)
    for _ in range(0 if rule == "mean" else RULE_ROUNDS):
        beyond = rotation_vectors(t_ns, rate, rule) - rotation_vectors(t_ns, rate, "mean")
        rate = _from_means((steps - beyond) / seconds)
    return rate


def _from_means(mean: Float64) -> Float64:
    """Return the smoothest values whose neighbours have these means."""
    sign = np.where(np.arange(len(mean) + 1) % 2, -1.0, 1.0)[:, None]
    values = np.zeros((len(mean) + 1, 3))
    np.cumsum(-2 * sign[:-1] * mean, axis=0, out=values[1:])
    values *= sign
    alternating = (sign[:-1] * np.diff(values, axis=0)).mean(axis=0) / 2
    return np.asarray(values + sign * alternating)
