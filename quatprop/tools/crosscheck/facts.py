"""A fact about a pair of sources, worded for either of them, and the tolerances."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

DEG: Final = math.radians(1.0)

SIGNIFICANT: Final = 5.0
"""Standard deviations beyond which a difference is stated."""


class Tolerances(NamedTuple):
    """Differences that do not matter, however significant.

    `offset`: s; 0.6 intervals of the slower source are tolerated in any case
    `mount`: rad
    `scale`: ratio
    `bias`: rad/s
    `drift`: of an orientation about its reference, rad/s
    `clock`: s/s
    """

    offset: float = 0.005
    mount: float = math.radians(2.0)
    scale: float = 0.02
    bias: float = math.radians(0.3)
    drift: float = math.radians(0.15)
    clock: float = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """How a statement reads if it is about one of the two sources.

    `text`: the statement about the source
    `settings`: what repairs it: setting -> value
    `remedy`: the same, as options of the commands that read it
    """

    text: str
    settings: Mapping[str, str] = field(default_factory=dict)
    remedy: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """One fact about a pair.

    `code`: as of :class:`.Finding`
    `a`, `b`: how it reads about each source; None: it cannot be about that one
    `numbers`: values with their standard deviations
    `is_sure`: whether no other reading explains it
    """

    code: str
    a: Side | None
    b: Side | None
    numbers: Mapping[str, Any] = field(default_factory=dict)
    is_sure: bool = True

    def about(self, side: str | None) -> Side:
        """Return how it reads about one side, ``"a"`` or ``"b"``, or about the only one."""
        if self.a is None or (self.b is not None and side == "b"):
            return self.b or Side(text="")
        return self.a


def value_text(value: float, sigma: float, unit: str, factor: float = 1.0) -> str:
    """Return a value with its standard deviation, both with as many digits as are known."""
    shown = max(abs(sigma * factor), 1e-9)
    digits = min(6, max(0, 1 - math.floor(math.log10(shown))))
    return f"{value * factor:.{digits}f} +- {shown:.{digits}f}{unit}"


def options_text(settings: Mapping[str, str]) -> str:
    """Return settings as options."""
    return " ".join(f"--{name.replace('_', '-')} {value}" for name, value in settings.items())
