"""The parser of a bias, and of the periods at rest that it may be measured at."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from quatprop.errors import UsageError
from quatprop.settings.parsers import Choice, moment, number_list, path
from quatprop.settings.rotations import STATIC, InMemory, is_name
from quatprop.text import did_you_mean, shown
from quatprop.times import Instant, duration_ns

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


def bias(value: object) -> tuple[float, ...] | StaticBias | InMemory | str:
    """Return three rates, rest, or a series of biases: a path, a topic or a series in memory."""
    if hasattr(value, "t_ns"):
        return InMemory(value)
    if isinstance(value, StaticBias):
        return value
    if isinstance(value, str) and value.partition(":")[0].strip() == STATIC:
        way, colon, window = value.partition(":")[2].partition(":")
        if not colon and way.strip() not in BETWEEN_RESTS:
            way, window = "", way
        between = Choice(*BETWEEN_RESTS)(way.strip()) if way else None
        try:
            window_ns = duration_ns(window) if window else StaticBias().window_ns
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
    try:
        return number_list("X,Y,Z")(value)
    except UsageError as error:
        raise UsageError(f"{error.text}, nor static[:DUR]") from None
