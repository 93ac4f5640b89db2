"""Parse column names into a key and a unit."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING

from quatprop.settings.quantities import SCALED_RATE_UNITS
from quatprop.tables.model import Column

if TYPE_CHECKING:
    from collections.abc import Sequence

TIME_NAMES = r"_*(?:t|ts|time|timestamp|time_?stamp|stamp)"
NOT_RATE = r"(?!b_w_|.*(?:bias|cov|std|var|noise|drift|offset|error|setpoint))"
_GYROSCOPE = (
    r"(?:gyro(?:scopes?|_?rate)?|gyr|omega|ang(?:ular)?_?(?:velocity|vel|rate)|rotation_?rate)"
)
GYROSCOPE = rf"{NOT_RATE}(?:(?:.*[._])?{_GYROSCOPE}[._]?|w[._]?)(?P<part>[xyz]|\[[012]\])"
AXIS_FIRST = rf"{NOT_RATE}(?:.*[._])?(?P<part>[xyz])_?{_GYROSCOPE}(?:_out)?"
NOT_ATTITUDE = r"(?!.*(?:cov|std|var|noise|sigma|delta|error|setpoint))"
NOT_ROTATION = (
    NOT_ATTITUDE + r"(?!.*(?:rate|speed|vel|acc|omega|gyr))(?!(?:.*[._])?des(?:ired)?[._])"
)
ROTATION_VECTOR = (
    rf"{NOT_ROTATION}(?:.*[._])?(?:rotvec|rotation_?vector|rot_?vec)[._]?(?P<part>[xyz])"
)
EULER = rf"{NOT_ROTATION}(?:.*[._])?(?P<part>yaw|pitch|roll)"
EULER_NUMBERED = NOT_ROTATION + r"(?:.*[._])?euler_{}_(?P<part>[123])"
"""Patterns of names that may have a unit as a suffix; the group ``part`` is the component."""

RATE_UNITS = {
    "rad/s": ("rad/s", "rads^-1", "rads-1", "rad_s", "rad_per_s", "rad_per_sec", "radps"),
    "deg/s": (
        *("deg/s", "degs^-1", "degs-1", "deg_s", "deg_per_s", "deg_per_sec", "degps"),
        *("dps", "\u00b0/s", "\u00ba/s"),
    ),
}
"""Unit of a rate -> spellings in headers, in lower case, without spaces and points."""

TIME_UNITS = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "millis", "millisecond", "milliseconds"),
    "us": ("us", "\u00b5s", "\u03bcs", "usec", "usecs", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
}
"""Unit of time -> spellings in headers."""

ANGLE_UNITS = {
    "rad": ("rad", "rads", "radian", "radians"),
    "deg": ("deg", "degs", "degree", "degrees", "\u00b0", "\u00ba"),
}
"""Unit of an angle -> spellings in headers."""

UNITS = {
    spelling: unit
    for units in (RATE_UNITS, TIME_UNITS, ANGLE_UNITS)
    for unit, spellings in units.items()
    for spelling in spellings
} | {spelling: unit for unit in SCALED_RATE_UNITS for spelling in (unit, unit.replace("/", "_"))}
"""Spelling -> unit."""

_WORDS = {
    r"^(?:degrees?|[\u00b0\u00ba])(?=.)": "deg",
    r"^radians?(?=/)|^rads(?=/)": "rad",
    r"/sec(?:ond)?s?$": "/s",
}
"""Pattern of a spelling within a unit in brackets -> short spelling."""

_CAPITAL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
"""Word boundary in camel case."""

_BRACKETS = re.compile(r"(.*?)\s*[\[(]([^\[\]()]*)[\])]")
# "sec" and "nanosec" are left out: at the end of a name they are the two halves of a timestamp.
_SUFFIXES = sorted({*UNITS} - {"sec", "secs", "nsec", "nsecs", "nanosec", "nanosecs"})
_SUFFIX = re.compile(rf"(?i)(.+?)_({'|'.join(map(re.escape, _SUFFIXES))})(\.[xyz]|\[[012]\])?")
"""A name, a unit, and an axis if the unit is that of a list or of components."""
_MAY_HAVE_SUFFIX = (
    GYROSCOPE,
    AXIS_FIRST,
    r"(?:.*[._])?g_?[xyz]",
    r"[pqr]|(?:.*[._])?(?:roll|pitch|yaw)_?rate",
    rf"(?:.*[._])?(?:{TIME_NAMES})(?:_[a-z]+)?",
    r"(?:.*[._])?(?:epoch|unix|posix|elapsed|uptime|boot|since_(?:re)?boot|since_start)",
    ROTATION_VECTOR,
    EULER,
    EULER_NUMBERED.format("[xyz]{3}"),
)


@lru_cache(maxsize=1024)
def parse_name(text: str) -> Column:
    """Return a column with the key and the unit of its name."""
    name = text.strip("\ufeff \t\"'").lstrip("#%/ \t").strip()
    bracketed = _BRACKETS.fullmatch(name)
    if bracketed and not bracketed[2].strip().isdecimal():
        unit = "".join(bracketed[2].lower().split())
        return Column(text, _key(bracketed[1]), UNITS.get(_spelling(unit), unit))
    name = _CAPITAL.sub("_", name)
    if suffixed := _SUFFIX.fullmatch(name):
        stem, suffix, axis = suffixed.groups(default="")
        key, unit = _key(stem + axis), UNITS[suffix.lower()]
        # PX4's gyro_rad[0] is in rad/s.
        may_have_it = unit not in ANGLE_UNITS if axis else True
        if may_have_it and any(re.fullmatch(known, key) for known in _MAY_HAVE_SUFFIX):
            return Column(text, key, unit)
    return Column(text, _key(name))


def whole_key(text: str) -> str:
    """Return the key of a name, including a unit that is a suffix."""
    name = text.strip("\ufeff \t\"'").lstrip("#%/ \t").strip()
    # mSec and uSec are one word.
    return _key(re.sub(r"(?i)([munµμ])sec", lambda unit: unit[0].lower(), name))


def as_option(names: Sequence[str], k: int) -> str:
    """Return the name of a column for an option, or its number if the name needs quotes."""
    name = names[k].strip()
    is_plain = re.fullmatch(r"[\w.+-]*[^\W\d][\w.+-]*", name, re.ASCII) and names.count(name) == 1
    return name if is_plain else str(k)


def rate_unit_of(fields: Sequence[str]) -> str | None:
    """Return the unit declared by the names of a rate: three axes or one vector."""
    names = fields if len(fields) > 1 else [f"{fields[0]}[0]"]
    unit, *others = {parse_name(name).unit for name in names}
    return None if others or unit not in {*RATE_UNITS, *SCALED_RATE_UNITS} else unit


def _spelling(unit: str) -> str:
    """Return a unit in brackets in the spelling of :data:`UNITS`."""
    unit = re.sub("\u207b\u00b9|\u2212" + "1", "^-1", unit)
    unit = re.sub(r"[.*\u00b7\u22c5]", "", unit).replace("per", "/")
    for pattern, spelling in _WORDS.items():
        unit = re.sub(pattern, spelling, unit)
    return unit


def _key(name: str) -> str:
    name = _CAPITAL.sub("_", name.strip())
    return re.sub(r"[\s-]+", "_", name.lower()).replace("/", ".").lstrip(".")
