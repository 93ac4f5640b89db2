"""Convert instants and durations between text and integer nanoseconds.

Only integers and decimals are used: at 1.7e9 s, the resolution of a float is 238 ns.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from typing import TYPE_CHECKING, Literal, NamedTuple

from quatprop.base.errors import UsageError
from quatprop.base.text import quoted

if TYPE_CHECKING:
    from fractions import Fraction

    import numpy as np
    from numpy.typing import NDArray

NS_PER_S = 1_000_000_000
"""Nanoseconds in a second."""

LATEST = 2**63 - 1
"""The last time that fits in int64 ns, in the year 2262."""

NS_PER_UNIT = {
    "ns": 1,
    "100ns": 100,
    "us": 1_000,
    "ms": 1_000_000,
    "s": NS_PER_S,
    "m": 60_000_000_000,
    "h": 3_600_000_000_000,
}
"""Nanoseconds in each unit of a duration, and in ticks of 100 ns."""

LONGEST_BARE_S = 1_000_000
"""s: a length of time of 11 days or more needs a unit: it is more likely in another one than s."""

_BARE = r"(?a)-?(\d+\.?\d*|\.\d+)([eE][+-]?\d\d?)?"
_PART = r"(\d+(?:\.\d*)?|\.\d+)(ns|us|ms|s|m|h)"
_RFC3339 = r"(?a)(\d{4}-\d\d-\d\d)[Tt ](\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?([Zz]|[+-]\d\d:\d\d)"


def open_range(start_ns: int | None, end_ns: int | None) -> tuple[int, int]:
    """Return a range as times in int64 ns; None: open. Dates may exceed these."""
    low, high = -LATEST if start_ns is None else start_ns, LATEST if end_ns is None else end_ns
    return min(max(low, -LATEST), LATEST), min(max(high, -LATEST), LATEST)


def duration_ns(text: str) -> int:
    """Return a duration such as ``"1m30s"``, ``"20ms"`` or ``"0.5s"`` in ns."""
    parts = re.findall(_PART, text)
    if not parts or "".join(number + unit for number, unit in parts) != text:
        raise UsageError(
            f"{quoted(text)} is not a duration; write a number with a unit, "
            "such as 20ms, 0.5s or 1m30s"
        )
    total = sum(Decimal(number) * NS_PER_UNIT[unit] for number, unit in parts)
    if total != int(total):
        raise UsageError(f"{quoted(text)} is finer than a nanosecond; round it")
    return int(total)


class Nanoseconds(int):
    """A length of time in ns; as a setting, a number without this type is in seconds."""

    __slots__ = ()


def length_ns(text: str) -> Nanoseconds:
    """Return a length of time in ns: as :func:`duration_ns`, or seconds without a unit.

    Seconds may be negative, and are rounded to whole ns.
    """
    if not re.fullmatch(_BARE, text):
        return Nanoseconds(duration_ns(text))
    # 0.1 means the decimal, not the nearest binary fraction.
    seconds = Decimal(text)
    if abs(seconds) >= LONGEST_BARE_S:
        raise UsageError(
            f"{quoted(text)} without a unit is in seconds; write {seconds:f}ns, or {seconds:f}s if "
            "it is that long"
        )
    ns = round(seconds * NS_PER_S)
    if seconds and not ns:
        raise UsageError(f"{quoted(text)} is in seconds, and finer than a nanosecond; round it")
    return Nanoseconds(ns)


def duration_text(ns: int) -> str:
    """Return a duration with a suitable unit, to six digits."""
    for unit in ("s", "ms", "us"):
        if abs(ns) >= NS_PER_UNIT[unit]:
            return f"{ns / NS_PER_UNIT[unit]:.6g} {unit}"
    return f"{ns} ns"


def utc_text(ns: int) -> str:
    """Return a time since 1970 as UTC, to the second."""
    moment = datetime(1970, 1, 1) + timedelta(seconds=ns // NS_PER_S)  # noqa: DTZ001  # UTC
    return moment.isoformat(timespec="seconds") + "Z"


def regular_stamps(start: int, stop: int, rate: Fraction) -> NDArray[np.int64]:
    """Return the timestamps of regular samples, without drift.

    `rate`: sample rate, Hz
    `Returns`: sample number / rate, rounded half to even; shape ``(stop - start,)``, int64, ns
    """
    import numpy as np

    return numbered_stamps(np.arange(start, stop), rate)


def numbered_stamps(numbers: NDArray[np.int64], rate: Fraction) -> NDArray[np.int64]:
    """Return the timestamps of samples by number, as :func:`regular_stamps`, shape ``(N,)``."""
    import numpy as np

    if not len(numbers):
        return np.empty(0, np.int64)
    start, low, high = (int(x) for x in (numbers[0], numbers.min(), numbers.max()))
    period, divisor = NS_PER_S * rate.denominator, rate.numerator
    if max(abs(low), abs(high) + 1) * period // divisor > LATEST:
        raise UsageError(
            f"at {float(rate):.6g} Hz the times of {high + 1} samples do not fit in int64 ns"
        )
    # The first in unbounded integers, the others relative to it, in 64 bits if they fit.
    whole, rest = divmod(start * period, divisor)
    small = (high - low + 1) * period + 2 * divisor <= LATEST
    relative = (numbers - start).astype(np.int64 if small else object) * period + rest
    stamps = whole + relative // divisor
    excess = 2 * (relative % divisor)
    up = (excess > divisor) | ((excess == divisor) & (stamps % 2 == 1))
    return np.asarray(stamps + up, dtype=np.int64)


def regular_count(elapsed_ns: int, rate: Fraction) -> int:
    """Return the number of regular samples from 0 to `elapsed_ns`, both included."""
    # Sample k is rounded to at most `elapsed_ns` if k / rate <= elapsed_ns + 1/2 ns.
    last, rest = divmod((2 * elapsed_ns + 1) * rate.numerator, 2 * NS_PER_S * rate.denominator)
    if rest == 0 and elapsed_ns % 2:
        last -= 1  # a half is rounded up to even
    return max(0, last + 1)


_LONGEST_LOG_NS = 10 * 366 * NS_PER_UNIT["h"] * 24
"""Longer durations are Unix times."""


class Instant(NamedTuple):
    """A point in time, absolute or relative to an end of the log.

    `ns`: time of the log's clock, or relative to `origin`, ns
    `origin`: ``"clock"`` (absolute), ``"first"`` or ``"last"`` (sample)
    """

    ns: int
    origin: Literal["clock", "first", "last"]

    def __str__(self) -> str:
        """Return the instant as text for :func:`instant`."""
        if self.origin == "clock":
            return str(self.ns)
        return f"{'+' if self.origin == 'first' else '-'}{abs(self.ns)}ns"


def instant(text: str) -> Instant:
    """Return an instant from RFC 3339, integer ns, or a signed duration.

    ``+10s`` and ``1m30s`` count from the first sample, ``-30s`` from the last.
    """
    if (ns := absolute_ns(text)) is not None:
        return Instant(ns, "clock")
    try:
        if text.startswith("-"):
            return Instant(-duration_ns(text[1:]), "last")
        ns = duration_ns(text.removeprefix("+"))
    except UsageError:
        raise UsageError(
            f"{quoted(text)} is not a time; write RFC 3339 (2024-01-31T12:00:00Z), integer "
            "nanoseconds, or a duration from the first (+10s) or the last sample (-30s)"
        ) from None
    if ns > _LONGEST_LOG_NS:
        raise UsageError(
            f"{quoted(text)} counts from the first sample, and no log is so long; write a Unix "
            "time as RFC 3339 (2024-01-31T12:00:00Z) or in ns, without a unit"
        )
    return Instant(ns, "first")


def absolute_ns(text: str) -> int | None:
    """Return a time, ns, from RFC 3339 or integer ns; None for other text."""
    if text.isdecimal():
        return int(text)
    if (match := re.fullmatch(_RFC3339, text)) is None:
        if re.fullmatch(_RFC3339, f"{text}Z"):
            raise UsageError(f"{quoted(text)} has no time zone; add one, such as Z for UTC")
        return None
    date, clock, fraction, zone = match.groups()
    try:
        moment = datetime.fromisoformat(f"{date}T{clock}{zone.upper().replace('Z', '+00:00')}")
    except ValueError as error:
        raise UsageError(f"{quoted(text)} is not a time: {error}") from None
    whole = moment - datetime(1970, 1, 1, tzinfo=UTC)
    seconds = whole.days * 86_400 + whole.seconds
    return seconds * NS_PER_S + int((fraction or "").ljust(9, "0"))
