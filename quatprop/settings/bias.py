"""A bias of the rates as users give it: three numbers, rest, or a series."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from quatprop.base.errors import UsageError
from quatprop.base.text import did_you_mean, listed, shown
from quatprop.settings.parsers import (
    STATIC,
    Choice,
    InMemory,
    is_name,
    length,
    moment,
    number_list,
    parts_of,
    path,
)
from quatprop.settings.quantities import RATES

if TYPE_CHECKING:
    from quatprop.base.times import Instant


_WITH_UNIT = r"(?a)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\s\d.,+-]+)\s*"
"""A number and its unit."""


class GivenBias(NamedTuple):
    """A constant bias.

    `values`: x, y, z
    `unit`: their unit, a key of :data:`quatprop.settings.quantities.RATES`; ``""``: that of the log
    """

    values: tuple[float, ...]
    unit: str = ""

    def __str__(self) -> str:
        """Return the text that :func:`bias` parses."""
        return ",".join(map(str, self.values)) + self.unit

    def rad_s(self, unit: float) -> tuple[float, ...]:
        """Return x, y, z, rad/s.

        `unit`: rad/s per unit of the log
        """
        factor = RATES[self.unit] if self.unit else unit
        return tuple(value * factor for value in self.values)


def given_bias(value: object, nor: str = "") -> GivenBias:
    """Return three rates: numbers in the unit of the log, or with a unit after the last or each.

    `nor`: what else a value may be, for the refusal of one that is not three numbers
    """
    parts = parts_of(value)
    found = [re.fullmatch(_WITH_UNIT, str(part)) for part in parts]
    numbers = [match[1] if match else part for match, part in zip(found, parts, strict=True)]
    try:
        values = number_list("X,Y,Z")(numbers)
    except UsageError:
        raise UsageError(f"{shown(value)} is not X,Y,Z, 3 finite numbers{nor}") from None
    *others, unit = (match[2] if match else "" for match in found)
    if others not in (["", ""], [unit, unit]):
        raise UsageError(f"{shown(value)} has several units; write 0.1,0.2,0.3deg/s")
    unit = "deg/s" if unit.lower() == "dps" else unit
    if unit and unit not in RATES:
        raise UsageError(f"{shown(value)} is not in one of {listed(RATES)}")
    return GivenBias(values, unit)


def bias_rad_s(value: object) -> tuple[float, ...]:
    """Return three rates, rad/s: numbers in that unit, or with another."""
    return given_bias(value).rad_s(1.0)


# The periods at rest that a bias may be measured at.


BETWEEN_RESTS = ("nearest", "interpolate")
"""How to combine several rests into a bias."""


class StaticBias(NamedTuple):
    """Take the mean rate at rest as the bias.

    `window_ns`: length of the windows in which rest is searched for, ns
    `start`, `end`: the period at rest, ends included; None to search for it
    `between`: how to combine several rests, one of :data:`BETWEEN_RESTS`; None to use a single
        rest
    """

    window_ns: int = 1_000_000_000
    start: Instant | None = None
    end: Instant | None = None
    between: str | None = None

    def __str__(self) -> str:
        """Return the text that :func:`bias` parses."""
        if self.start is not None:
            return f"{STATIC}@{self.start}..{self.end}"
        way = f"{self.between}:" if self.between else ""
        return f"{STATIC}:{way}{self.window_ns}ns"


def bias(value: object) -> GivenBias | StaticBias | InMemory | str:
    """Return three rates, rest, or a series of biases: a path, a topic or a series in memory."""
    if hasattr(value, "t_ns"):
        return InMemory(value)
    if isinstance(value, StaticBias | GivenBias):
        return value
    if isinstance(value, str) and value.partition(":")[0].strip() == STATIC:
        way, colon, window = value.partition(":")[2].partition(":")
        if not colon and way.strip() not in BETWEEN_RESTS:
            way, window = "", way
        between = Choice(*BETWEEN_RESTS)(way.strip()) if way else None
        try:
            window_ns = int(length(window)) if window else StaticBias().window_ns
        except UsageError as error:
            raise UsageError(error.text + did_you_mean(window, BETWEEN_RESTS)) from None
        return StaticBias(window_ns, between=between)
    if isinstance(value, str) and value.partition("@")[0].strip() == STATIC:
        start, dots, end = value.partition("@")[2].partition("..")
        if not (start.strip() and dots and end.strip()):
            raise UsageError(f"{shown(value)} is not a time range; write static@+10s..+20s")
        return StaticBias(start=moment(start.strip()), end=moment(end.strip()))
    # With commas, it may be an attempt at numbers.
    if is_name(value) and ("," not in str(value) or Path(value).exists()):
        return path(value)
    return given_bias(value, nor=", nor static[:DUR]")
