"""The integration rule as a mistake: the rates that led to A by one rule, propagated by another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.association import interval_ns
from quatprop.comparison.undoings import Sides, Undoing, recomposed
from quatprop.kinematics.increments import rotation_vectors
from quatprop.kinematics.rates import rotation_vectors_between
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

SAME = 1e-6
"""rad: the rates must lead back to A."""


def integration_rules(likely: Sequence[tuple[str, str]], a: AttitudeSeries) -> Undoing:
    """Return pairs of rules that explain an error about as well, the best first, as a mistake.

    An interval later, or half of one, is what several of them differ by.
    """
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
        changed = by_other_rule(sides.a, known, other)
        return sides if changed is None else sides._replace(a=changed)

    return Undoing("method", "another integration rule", sentence, remedy, apply)


@np.errstate(over="ignore", invalid="ignore")  # of rates that grow without bound
def by_other_rule(a: AttitudeSeries, known: str, other: str) -> AttitudeSeries | None:
    """Return A as another rule leads to it, if a known one can have led to it."""
    if len(a) < MIN_SAMPLES:
        return None
    steps = rotation_vectors_between(a.wxyz)
    mean = steps / (np.diff(a.t_ns)[:, None] / NS_PER_S)
    rate = _rates(a.t_ns, steps, known)
    rough, smooth = (float(np.square(np.diff(one, axis=0)).sum()) for one in (rate, mean))
    back = rotation_vectors(a.t_ns, rate, known)
    if not (rough <= ROUGH * smooth and np.abs(back - steps).max() <= SAME):
        return None
    return recomposed(a, np.asarray(rotation_vectors(a.t_ns, rate, other)))


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
