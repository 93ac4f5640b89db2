"""Conventions of tables: how the columns of time and rates are called, and in what units.

A convention that is known is one line of :data:`DIALECTS`. Beyond it, names that clearly mean
gyroscope axes or time are recognised (:data:`GENERIC`), but their units only where the header
says them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

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
"""How headers spell the units of a rate, without spaces and in small letters."""

TIME_UNITS = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "millisecond", "milliseconds"),
    "us": ("us", "\u00b5s", "\u03bcs", "usec", "usecs", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
}
"""How headers spell the units of time."""

_SPELLED = {
    spelling: unit
    for units in (RATE_UNITS, TIME_UNITS)
    for unit, spellings in units.items()
    for spelling in spellings
}


@dataclass(frozen=True, slots=True)
class Dialect:
    """How one source of tables names its columns.

    Patterns are regular expressions for whole :attr:`Column.key` values.

    Parameters
    ----------
    name
        What the summary calls it.
    rate
        Rate columns; the group ``axis`` tells the axis, the rest must be the same in all three.
    time
        Time columns, the preferred one first. A column ``sec`` or ``secs`` has its nanoseconds
        in a column beside it.
    rate_unit, time_unit
        Units by convention, where the header does not say them; ``""`` where it must.
    log_time
        The column of the time of recording, if there is one beside the message's own stamp.
    needs
        Further columns, or the first line of the file, by which it is told from others.
    file
        Pattern found in the name of the file, where columns alone do not tell a gyroscope.
    method
        What the sensor does, where the convention says it: ``"end"`` for averages over the
        interval before the stamp.
    """

    name: str
    rate: str
    time: tuple[str, ...]
    rate_unit: str = ""
    time_unit: str = ""
    log_time: str = ""
    needs: tuple[str, ...] = ()
    file: str = ""
    method: str | None = None


_AXIS = r"(?P<axis>[xyz])"
_INDEX = r"\[(?P<axis>[012])\]"
_ROS_RATE = r"(?:.*\.)?(?:angular_velocity|twist\.angular)\." + _AXIS
_ROS_STAMP = r"(?:.*\.)?header\.stamp\.secs?"
_GYRO = (
    r"(?!.*(?:bias|cov|std|var|noise))(?:(?:.*[._])?(?:gyroscope|gyro|gyr|omega|angular_?velocity|angular_?rate|ang_?vel"
    r"|rotation_?rate)[._]?|w[._]?)(?P<axis>[xyz]|\[[012]\])"
)
TIME_NAMES = r"t|time|timestamp|time_?stamp|stamp"

DIALECTS = (
    Dialect("quatprop", r"w" + _AXIS, (r"t",), "rad/s", "ns", needs=("t_ns",)),
    Dialect("EuRoC", r"w_[a-z]+_[a-z]+_" + _AXIS, (r"timestamp",), "rad/s", "ns"),
    Dialect("PX4 ulog2csv", r"gyro_rad" + _INDEX, (r"timestamp",), "rad/s", "us", method="end"),
    Dialect(
        "PX4 ulog2csv",
        r"(?P<axis>roll|pitch|yaw)speed",
        (r"timestamp",),
        "rad/s",
        "us",
        needs=("q[0]", "q[3]"),
    ),
    Dialect(
        "PX4 ulog2csv",
        r"xyz" + _INDEX,
        (r"timestamp",),
        "rad/s",
        "us",
        file=r"vehicle_angular_velocity",
    ),
    Dialect(
        "PX4 ulog2csv",
        _AXIS,
        (r"timestamp",),
        "rad/s",
        "us",
        needs=("device_id",),
        file=r"sensor_gyro(?!_fifo)",
    ),
    Dialect(
        "rostopic echo -p",
        r"field\." + _ROS_RATE,
        (r"field\.(?:.*\.)?header\.stamp", r"time"),
        "rad/s",
        "ns",
        log_time=r"time",
        needs=("%time",),
    ),
    Dialect(
        "ROS messages as columns",
        _ROS_RATE,
        (_ROS_STAMP, r"(?:.*\.)?header\.stamp"),
        "rad/s",
        log_time=r"time",
    ),
    Dialect("gcsv", r"g" + _AXIS, (r"t",), "rad/s", needs=("gyroflow imu log",)),
    Dialect("x-io", r"gyroscope_" + _AXIS, (r"time|timestamp",)),
    Dialect(
        "Sensor Logger",
        _AXIS,
        (r"time",),
        "rad/s",
        "ns",
        needs=("seconds_elapsed",),
        file=r"(?i)gyroscope",
    ),
)
"""Every known convention, told in this order."""

GENERIC = Dialect("", _GYRO, (_ROS_STAMP, r"(?:stamp[._])?secs?", TIME_NAMES))
"""Names that clearly mean gyroscope axes and time, but no units."""

AXES = {
    axis: k
    for names in ("xyz", "012", ("[0]", "[1]", "[2]"), ("roll", "pitch", "yaw"))
    for k, axis in enumerate(names)
}
"""Which axis a group ``axis`` means."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column name taken apart.

    Parameters
    ----------
    name
        As the header spells it.
    key
        In small letters, words joined by ``_``, levels by ``.``, without its unit.
    unit
        The unit as one of this package's names, ``""`` where the name says none, or the text of
        one that is not known.
    """

    name: str
    key: str
    unit: str = ""


_BRACKETS = re.compile(r"(.*?)\s*[\[(]([^\[\]()]*)[\])]")
# "sec" and "nanosec" are left out: at the end of a name they are the two halves of a stamp.
_SUFFIXES = sorted({*_SPELLED} - {"sec", "secs", "nsec", "nsecs", "nanosec", "nanosecs"})
_SUFFIX = re.compile(rf"(?i)(.+?)_({'|'.join(map(re.escape, _SUFFIXES))})")


def column(name: str) -> Column:
    """Take a column name apart.

    Examples
    --------
    >>> column("w_RS_S_x [rad s^-1]").unit
    'rad/s'
    >>> column("gyro_rad[0]").key
    'gyro_rad[0]'
    """
    text = name.strip("\ufeff \t\"'").lstrip("#%/ \t").strip()
    bracketed = _BRACKETS.fullmatch(text)
    if bracketed and not bracketed[2].strip().isdecimal():
        unit = "".join(bracketed[2].lower().split())
        return Column(name, _key(bracketed[1]), _SPELLED.get(unit, unit))
    suffixed = _SUFFIX.fullmatch(text)
    if suffixed and re.fullmatch(rf"{_GYRO}|(?:.*[._])?(?:{TIME_NAMES})", _key(suffixed[1])):
        return Column(name, _key(suffixed[1]), _SPELLED[suffixed[2].lower()])
    return Column(name, _key(text))


def _key(text: str) -> str:
    return re.sub(r"\s+", "_", text.strip().lower()).replace("/", ".").lstrip(".")
