"""Hypotheses about an error: combinations of mistakes, and the penalty of each."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from quatprop.comparison.mistakes import Mistake

PENALTIES = {
    "axes": 0.4,
    "scale": 0.3,
    "clock drift": 0.4,
    "reference frame": 0.45,
    "body frame": 0.45,
    "rate bias": 0.27,
    "drift": 0.25,
}
"""Mistake -> share to which it has to reduce the residual: the smaller, the more it fits."""

PENALTY = 0.5
"""The same for all other mistakes."""

CLOCKS = ("time offset", "clock drift")

INDISTINCT = {
    ("axes", "body frame"),
    ("reference frame", "body frame"),
    ("body frame", "reference frame"),
    ("clock drift", "time offset"),
}
"""Pairs of which the second is no alternative to the first: it is equivalent, or a part of it."""

MISREAD = {
    *("conjugate", "layout", "layout-first"),
    *("layout and conjugate", "layout-first and conjugate"),
}
"""Misread quaternions of one series."""

READINGS = {*MISREAD, "axes", "rate sign", "side"}
"""Mistakes without parameters; a hypothesis has at most one."""

RATE_REMEDIES = {"rate bias", "scale", "method"}
"""Mistakes whose remedy is to propagate again."""

LIKE_CLOCK_DRIFT = {"rate bias", "scale", "drift"}
"""Mistakes that make the same error as a clock drift if the body turns steadily."""


class Hypothesis(NamedTuple):
    """Which mistakes were made, by their keys; empty for none of that kind."""

    reading: str = ""
    clock: str = ""
    rates: str = ""
    frames: str = ""


class Fit(NamedTuple):
    """How well a hypothesis explains an error.

    `mistakes`: the mistakes, with their estimated parameters
    `rms`: RMS error that remains when they are undone, rad
    `score`: the same divided by the penalties; the smallest is the best
    """

    mistakes: tuple[Mistake, ...]
    rms: float
    score: float


NO_FIT = Fit((), math.inf, math.inf)
"""The fit of a hypothesis that cannot be tested."""
