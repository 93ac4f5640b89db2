"""Which mistakes are undone together, and what each has to explain."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from quatprop.comparison.undoing import Undoing

PRICES = {
    "axes": 0.4,
    "scale": 0.3,
    "clock drift": 0.4,
    "reference frame": 0.45,
    "body frame": 0.45,
    "rate bias": 0.27,
    "drift": 0.25,
}
"""Mistake -> share of the error that may remain when it is undone: less of it, the more is
fitted."""

PRICE = 0.5
"""The same for all other mistakes."""

CLOCKS = ("time offset", "clock drift")

CONTAINED = {
    ("axes", "body frame"),
    ("reference frame", "body frame"),
    ("body frame", "reference frame"),
    ("clock drift", "time offset"),
}
"""Mistakes of which the second is no alternative to the first: it has as much, or is a part."""

MISREAD = {
    *("conjugate", "layout", "layout-first"),
    *("layout and conjugate", "layout-first and conjugate"),
}
"""Quaternions of one series that were read otherwise than they were written."""

READINGS = {*MISREAD, "axes", "rate sign", "side"}
"""Mistakes without parameters, of which one is made."""

RATE_REMEDIES = {"rate bias", "scale", "method"}
"""Mistakes that are undone by propagating again."""


class Undoings(NamedTuple):
    """Which mistakes are undone, by their keys; empty if none is of that kind."""

    reading: str = ""
    clock: str = ""
    rates: str = ""
    frames: str = ""


class Explanation(NamedTuple):
    """What is undone, the RMS error that remains, rad, and that over its price."""

    undone: tuple[Undoing, ...]
    rms: float
    score: float


NOTHING = Explanation((), math.inf, math.inf)
"""What cannot be tried."""
