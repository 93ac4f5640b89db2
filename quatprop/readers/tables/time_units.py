"""Units of times in tables: those of :data:`TIME_UNITS`, ticks of any length, times since a date.

A unit is text in which a table states it: ``"ms"``; a number of units, as ``"0.01 s"``; one of
these since an epoch, as ``"s since 2021-05-01T00:00:00Z"``.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from quatprop.base.times import NS_PER_S

PLACES = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Unit -> decimal places with which an unscaled number is in ns."""

TICKS = "100ns"
"""Ticks of .NET and Windows."""

TIME_OF_DAY = "time of day"
"""The unit of text such as ``10:00:00.5`` or ``1:02:03 PM``."""

TIME_OF_HOUR = "time of hour"
"""The unit of text such as ``58:01.5``, as which Excel saves times of day."""

SECONDS = "text in s"
"""The unit of text such as ``980.005 sec``, as which MATLAB writes durations."""

DAY_DIGITS = "hhmmss"
"""The unit of text such as ``095801.50``, as in NMEA 0183 and VBO."""

COUNTS = {unit: f"s and {unit}" for unit in ("ms", "us", "ns")}
"""Unit -> that of text such as ``12.5``, seconds and a count of units without leading zeros."""

DAY_COUNTS = {unit: f"{TIME_OF_DAY} and {unit}" for unit in COUNTS}
"""The same for text such as ``10:00:12.5``."""

DAY_TIME = (
    r"\s*(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d)(?:[.,](?P<part>\d+)|:(?P<ms>\d{3}))?"
    r"\s*(?:(?P<half>[AaPp])\.?[Mm]\.?)?\s*"
)
"""Hours, minutes, seconds; decimals, or ms after a colon; a or p of AM and PM."""

HOUR_TIME = r"\s*(?P<m>\d{1,3}):(?P<s>\d\d)[.,](?P<part>\d+)\s*"
SECONDS_TEXT = r"\s*(?P<s>\d{1,9})(?:[.,](?P<part>\d+))?\s*sec(?:onds?)?\s*"
_DIGITS = r"\s*(?P<h>\d\d)(?P<m>\d\d)(?P<s>\d\d)(?:[.,](?P<part>\d+))?\s*"
_DAY_COUNT = r"\s*(?P<h>\d{1,2}):(?P<m>\d{1,2}):(?P<s>\d{1,2})[.,](?P<count_%s>0|[1-9]\d{0,%d})\s*"
_COUNT = r"\s*(?P<whole>\d{1,10})[.,](?P<%s>0|[1-9]\d{0,%d})\s*"

TEXTS = {
    TIME_OF_DAY: DAY_TIME,
    TIME_OF_HOUR: HOUR_TIME,
    SECONDS: SECONDS_TEXT,
    DAY_DIGITS: _DIGITS,
    COUNTS["ms"]: _COUNT % ("ms", 2),
    COUNTS["us"]: _COUNT % ("us", 5),
    COUNTS["ns"]: _COUNT % ("ns", 8),
    DAY_COUNTS["ms"]: _DAY_COUNT % ("ms", 2),
    DAY_COUNTS["us"]: _DAY_COUNT % ("us", 5),
    DAY_COUNTS["ns"]: _DAY_COUNT % ("ns", 8),
}
"""Unit of times that are text -> pattern, whose groups are named as the parts of the time."""

WEEKS = "week since 1980-01-06T00:00:00Z"
"""The unit of GPS weeks."""

_NS = {
    "ns": 1,
    TICKS: 100,
    "us": 10**3,
    "ms": 10**6,
    "s": NS_PER_S,
    "min": 60 * NS_PER_S,
    "h": 3600 * NS_PER_S,
    "d": 86_400 * NS_PER_S,
    "week": 7 * 86_400 * NS_PER_S,
}
_SPELLED = {
    r"n(?:ano)?s(?:ec(?:ond)?s?)?": "ns",
    r"(?:u|\u00b5|\u03bc|micro)s(?:ec(?:ond)?s?)?": "us",
    r"m(?:illi)?s(?:ec(?:ond)?s?)?": "ms",
    r"s(?:ec(?:ond)?s?)?": "s",
    r"min(?:ute)?s?": "min",
    r"h(?:(?:ou)?rs?)?": "h",
    r"d(?:ays?)?": "d",
}
_SINCE = re.compile(
    r"(?ai)(?P<unit>\S+)\s+since\s+(?P<date>\d{4}-\d\d?-\d\d?)"
    r"(?:[T ]\s*(?P<hour>\d\d?):(?P<minute>\d\d?)(?::(?P<second>\d\d?)(?:\.(?P<part>\d+))?)?)?"
    r"\s*(?:z|utc|gmt|(?P<zone>[+-]\d\d?(?::?\d\d)?))?"
)
_PER = "ticks at "
_NUMBERED = re.compile(r"(?a)([\d.]+(?:e[+-]?\d+)?) ?([a-z]+)")


class TimeScale(NamedTuple):
    """How numbers become ns since 1970.

    `places`: decimal places with which an unscaled number is a whole number of steps
    `step_ns`: length of a step, ns
    `epoch_ns`: time of the number 0, ns
    """

    places: int
    step_ns: Fraction = Fraction(1)
    epoch_ns: int = 0


def ticks(rate: Fraction) -> str:
    """Return the unit of ticks at a rate, Hz."""
    return f"{_PER}{rate} Hz"


def is_ticks(unit: str) -> bool:
    """Return whether a unit is that of ticks at a rate."""
    return unit.startswith(_PER)


def is_time_unit(unit: str) -> bool:
    """Return whether a text is a unit of time."""
    return unit in TEXTS or _scale_of(unit) is not None


def time_scale(unit: str) -> TimeScale:
    """Return the scale of a unit of numbers."""
    scale = _scale_of(unit)
    if scale is None:
        raise KeyError(unit)
    return scale


@lru_cache(maxsize=64)
def _scale_of(unit: str) -> TimeScale | None:
    if unit in PLACES:
        return TimeScale(PLACES[unit])
    length, _, epoch = unit.partition(" since ")
    epoch_ns = _ns_of(epoch) if epoch else 0
    if length in PLACES:
        return TimeScale(PLACES[length], epoch_ns=epoch_ns)
    if length in _NS:
        tick_ns = Fraction(_NS[length])
    elif is_ticks(length):
        tick_ns = _NS["s"] / Fraction(length.removeprefix(_PER).removesuffix(" Hz"))
    elif (match := _NUMBERED.fullmatch(length)) and match[2] in _NS:
        tick_ns = Fraction(Decimal(match[1])) * _NS[match[2]]
    else:
        return None
    if tick_ns <= 0:
        return None
    # Decimals of a tick are kept as far as they are longer than a nanosecond or two.
    places = max(0, len(str(int(tick_ns))) - 1) if tick_ns != _NS[TICKS] else 0
    return TimeScale(places, tick_ns / 10**places, epoch_ns)


def _ns_of(date: str) -> int:
    moment, _, part = date.removesuffix("Z").partition(".")
    whole = datetime.fromisoformat(moment).replace(tzinfo=UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    seconds = whole.days * 86_400 + whole.seconds
    return seconds * NS_PER_S + int(part.ljust(9, "0")[:9] or 0)


def since_a_date(text: str) -> str:
    """Return a unit such as ``seconds since 2021-05-01``, as of the CF conventions; else ``""``."""
    match = _SINCE.fullmatch(text.strip())
    if match is None:
        return ""
    short = (
        unit for spelling, unit in _SPELLED.items() if re.fullmatch(spelling, match["unit"].lower())
    )
    unit = next(short, "")
    year, month, day = map(int, match["date"].split("-"))
    hour, minute, second = (int(match[name] or 0) for name in ("hour", "minute", "second"))
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return ""
    if zone := match["zone"]:
        digits = zone[1:].replace(":", "").ljust(3, "0") if len(zone) > 3 else f"{zone[1:]}00"  # noqa: PLR2004
        minutes = int(digits[:-2]) * 60 + int(digits[-2:])
        moment -= timedelta(minutes=minutes) * (-1 if zone[0] == "-" else 1)
    if not unit:
        return ""
    part = f".{match['part']}" if match["part"] else ""
    return f"{unit} since {moment.replace(tzinfo=None).isoformat()}{part}Z"


def ticks_since(value: float) -> str:
    """Return the unit of ticks of 100 ns with the epoch that their number shows.

    Since 1601, as in Windows, or since the year 1, as in .NET, if it is in this century then.
    """
    for epoch in (1601, 1):
        unit = f"{TICKS} since {epoch:04d}-01-01T00:00:00Z"
        since_1970 = value * 100 + time_scale(unit).epoch_ns
        if _FROM_2000_NS <= since_1970 < _UNTIL_2100_NS:
            return unit
    return TICKS


_FROM_2000_NS, _UNTIL_2100_NS = 946_684_800 * NS_PER_S, 4_102_444_800 * NS_PER_S
