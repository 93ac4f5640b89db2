"""Parsers of values from users: text, TOML values or Python values.

Each returns the value in the type that the program uses, accepts its own results, and
raises a :class:`quatprop.errors.UsageError` that does not name the setting.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from datetime import datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from operator import index
from os import PathLike, fspath
from typing import Any, TypeAlias

from quatprop.errors import UsageError
from quatprop.text import did_you_mean, listed, shown
from quatprop.times import Instant, duration_ns, instant

Parser: TypeAlias = Callable[[object], Any]
"""Returns a value in the type that the program uses, or raises a UsageError about it."""

MAX_FREQUENCY = 1_000_000_000
"""Hz: stamps are whole nanoseconds."""

MIN_FREQUENCY = Decimal("1e-9")
"""Hz: an interval of 31 years."""


def text(value: object) -> str:
    """Return text that is not empty."""
    if not isinstance(value, str) or not value:
        raise UsageError(f"{shown(value)} is not a name")
    return value


def flag(value: object) -> bool:
    """Return True or False."""
    if not isinstance(value, bool):
        raise UsageError(f"{shown(value)} is not true or false")
    return value


def path(value: object) -> str:
    """Return a path as text."""
    if not isinstance(value, str | PathLike) or not str(value) or "\0" in str(value):
        raise UsageError(f"{shown(value)} is not a path")
    return str(fspath(value))


def choice_named(value: str, names: Iterable[str]) -> str:
    """Return the matching name, ignoring case; else the value itself."""
    name = value.lower()
    if name not in names:
        name = {"dps": "deg/s", "reference": "inertial"}.get(name, name)
    return name if name in names else value


class Choice:
    """A parser that accepts one of a few names."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def __call__(self, value: object) -> str:
        """Return the name."""
        hint = ""
        if isinstance(value, str):
            if (name := choice_named(value, self.names)) in self.names:
                return name
            hint = did_you_mean(value, self.names)
        raise UsageError(f"{shown(value)} is not one of {listed(self.names)}{hint}")


def column_list(names: str) -> Callable[[object], tuple[str, ...]]:
    """Return a parser of as many columns as `names` has, such as ``"X,Y,Z"``.

    Names in brackets are optional: ``"A,B,C[,D]"``.
    """
    counts = range(names.partition("[")[0].count(",") + 1, names.count(",") + 2)

    def parse_columns(value: object) -> tuple[str, ...]:
        parts = tuple(str(part).strip() for part in parts_of(value))
        if len(parts) not in counts or not all(parts):
            number = " or ".join(map(str, counts))
            raise UsageError(f"{shown(value)} does not name {number} columns {names}")
        if len(set(parts)) != len(parts):
            raise UsageError(f"{shown(value)} names a column twice")
        return parts

    return parse_columns


def number_list(names: str) -> Callable[[object], tuple[float, ...]]:
    """Return a parser of as many numbers as `names` has, such as ``"W,X,Y,Z"``."""
    count = names.count(",") + 1

    def parse_numbers(value: object) -> tuple[float, ...]:
        try:
            parts = tuple(float(str(part)) for part in parts_of(value))
        except ValueError:
            parts = ()
        if len(parts) != count or not all(map(math.isfinite, parts)):
            raise UsageError(f"{shown(value)} is not {names}, {count} finite numbers")
        return parts

    return parse_numbers


def number(value: object) -> float:
    """Return a finite number."""
    try:
        parsed = float(str(value))
    except ValueError:
        parsed = math.nan
    if not math.isfinite(parsed) or isinstance(value, bool):
        raise UsageError(f"{shown(value)} is not a finite number")
    return parsed


def count(value: object) -> int:
    """Return a whole number of at least one."""
    try:
        parsed = int(value) if isinstance(value, str) else _whole(value)
    except ValueError:
        parsed = None
    if parsed is None or parsed < 1:
        raise UsageError(f"{shown(value)} is not a whole number above 0")
    return parsed


def frequency(value: object) -> Fraction:
    """Return a frequency in Hz as an exact decimal or fraction."""
    # By its text: 29.97 means the decimal, not the nearest binary fraction.
    text = str(value).removesuffix("Hz").strip()
    numerator, _, denominator = text.partition("/")
    try:
        # The size first: the exact value of 1e-99999999 would fill the memory.
        if MIN_FREQUENCY <= Decimal(numerator) / Decimal(denominator or 1) <= MAX_FREQUENCY:
            return Fraction(text)
    except (ValueError, ArithmeticError):
        pass
    raise UsageError(
        f"{shown(value)} is not a rate from 1e-9 to 1e9 Hz; write 100, 29.97 or 30000/1001"
    )


def duration(value: object) -> int:
    """Return a duration in ns: text with units, whole nanoseconds, or a timedelta."""
    if isinstance(value, timedelta):
        # Those of pandas also have nanoseconds.
        return value // timedelta(microseconds=1) * 1000 + getattr(value, "nanoseconds", 0)
    if (whole := _whole(value)) is not None:
        return whole
    if isinstance(value, str):
        return duration_ns(value)
    raise UsageError(f"{shown(value)} is not a duration; write text such as '20ms', or whole ns")


def signed_duration(value: object) -> int:
    """Return a duration in ns that may be negative, such as ``"-12ms"``."""
    if isinstance(value, str) and value.startswith("-"):
        return -duration(value[1:])
    return duration(value.removeprefix("+") if isinstance(value, str) else value)


def length(value: object) -> int:
    """Return a duration above zero, in ns."""
    parsed = duration(value)
    if parsed <= 0:
        raise UsageError(f"{shown(value)} is not a duration above 0")
    return parsed


def moment(value: object) -> Instant:
    """Return an instant: text, whole nanoseconds, or a datetime with its zone."""
    if isinstance(value, Instant):
        return value
    if isinstance(value, datetime):
        if value.tzinfo is None:
            raise UsageError(f"{shown(value)} needs a time zone, such as tzinfo=datetime.UTC")
        value = value.isoformat()
    ns = int(value) if isinstance(value, str) and value.isdecimal() else _whole(value)
    if ns is None and isinstance(value, str):
        return instant(value)
    if ns is None:
        raise UsageError(f"{shown(value)} is not a time; write text, whole ns, or a datetime")
    return Instant(ns, "clock")


def parts_of(value: object) -> list[object]:
    """Return the parts of text with commas, of a list, or of an array."""
    if isinstance(value, str):
        return list(value.split(","))
    convert = getattr(value, "tolist", None)
    value = value if convert is None else convert()
    try:
        return list(value) if isinstance(value, Iterable) else [value]
    except TypeError:
        return [value]


def _whole(value: object) -> int | None:
    """Return a whole number of any type, also of NumPy; None for other values and for booleans."""
    try:
        return None if str(value) in {"True", "False"} else index(value)  # type: ignore[arg-type]
    except TypeError:
        return None
