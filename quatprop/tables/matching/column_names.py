"""Column names taken apart: the name proper and the unit that it declares."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from quatprop.tables.matching.dialects import (
    EULER,
    EULER_NUMBERED,
    GYROSCOPE,
    ROTATION_VECTOR,
    TIME_NAMES,
)

RATE_UNITS = {
    "rad/s": (
        *("rad/s", "rads^-1", "rad*s^-1", "rad.s^-1", "rad/sec", "rad_s", "rad_per_s", "radps"),
        *("radian/s", "radians/s", "radians/sec"),
    ),
    "deg/s": (
        *("deg/s", "degs^-1", "deg*s^-1", "deg.s^-1", "deg/sec", "deg_s", "deg_per_s", "degps"),
        *("dps", "\u00b0/s", "\u00ba/s", "degree/s", "degrees/s", "degrees/sec"),
    ),
}
"""How headers spell the units of a rate, without spaces and in lower case."""

TIME_UNITS = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "millisecond", "milliseconds"),
    "us": ("us", "\u00b5s", "\u03bcs", "usec", "usecs", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
}
"""How headers spell the units of time."""

ANGLE_UNITS = {
    "rad": ("rad", "rads", "radian", "radians"),
    "deg": ("deg", "degs", "degree", "degrees", "\u00b0", "\u00ba"),
}
"""How headers spell the units of an angle."""

UNITS = {
    spelling: unit
    for units in (RATE_UNITS, TIME_UNITS, ANGLE_UNITS)
    for unit, spellings in units.items()
    for spelling in spellings
}
"""The unit that each spelling means."""

_BRACKETS = re.compile(r"(.*?)\s*[\[(]([^\[\]()]*)[\])]")
# "sec" and "nanosec" are left out: at the end of a name they are the two halves of a timestamp.
_SUFFIXES = sorted({*UNITS} - {"sec", "secs", "nsec", "nsecs", "nanosec", "nanosecs"})
_SUFFIX = re.compile(rf"(?i)(.+?)_({'|'.join(map(re.escape, _SUFFIXES))})")
_MAY_HAVE_SUFFIX = (
    GYROSCOPE,
    rf"(?:.*[._])?(?:{TIME_NAMES})",
    ROTATION_VECTOR,
    EULER,
    EULER_NUMBERED.format("[xyz]{3}"),
)


@dataclass(frozen=True, slots=True)
class ColumnName:
    """A column name taken apart.

    Parameters
    ----------
    text
        As the header spells it.
    key
        In lower case, words joined by ``_``, levels by ``.``, without its unit.
    unit
        The unit as one of this package's names, ``""`` where the name declares none, or the text
        of one that is not recognised.
    """

    text: str
    key: str
    unit: str = ""


@lru_cache(maxsize=1024)
def parse_name(text: str) -> ColumnName:
    """Take a column name apart.

    Examples
    --------
    >>> parse_name("w_RS_S_x [rad s^-1]").unit
    'rad/s'
    >>> parse_name("gyro_rad[0]").key
    'gyro_rad[0]'
    """
    name = text.strip("\ufeff \t\"'").lstrip("#%/ \t").strip()
    bracketed = _BRACKETS.fullmatch(name)
    if bracketed and not bracketed[2].strip().isdecimal():
        unit = "".join(bracketed[2].lower().split())
        return ColumnName(text, _key(bracketed[1]), UNITS.get(unit, unit))
    suffixed = _SUFFIX.fullmatch(name)
    if suffixed and any(re.fullmatch(stem, _key(suffixed[1])) for stem in _MAY_HAVE_SUFFIX):
        return ColumnName(text, _key(suffixed[1]), UNITS[suffixed[2].lower()])
    return ColumnName(text, _key(name))


def _key(name: str) -> str:
    return re.sub(r"\s+", "_", name.strip().lower()).replace("/", ".").lstrip(".")
