"""Conventions of tables: how the columns of a quaternion are called, and in what order.

Names that say w, x, y and z need no layout, whatever their order. Components that are numbered do
not say which is the scalar; only a convention that is known beyond doubt is trusted with those.
"""

from __future__ import annotations

from dataclasses import dataclass

from quatprop.tables.matching.rate_dialects import TIME_NAMES

PARTS = {
    part: k
    for names in ("wxyz", ("q0", "q1", "q2", "q3"), ("[0]", "[1]", "[2]", "[3]"))
    for k, part in enumerate(names)
}
"""Which component of wxyz a group ``part`` means; numbers only in conventions that say so."""


@dataclass(frozen=True, slots=True)
class AttitudeDialect:
    """How one source of tables names the columns of its quaternions.

    Patterns are regular expressions for whole
    :attr:`quatprop.tables.matching.rate_dialects.Column.key` values.

    Parameters
    ----------
    name
        What the summary calls it.
    quaternion
        Quaternion columns; the group ``part`` tells the component, the rest must be the same in
        all four.
    time
        Time columns, the preferred one first.
    time_unit
        By convention, where the header does not say it; ``""`` where it must.
    log_time
        The column of the time of recording, if there is one beside the message's own stamp.
    needs
        Further columns by which it is told from others.
    file
        Pattern found in the name of the file, where columns alone do not tell.
    """

    name: str
    quaternion: str
    time: tuple[str, ...]
    time_unit: str = ""
    log_time: str = ""
    needs: tuple[str, ...] = ()
    file: str = ""


_PART = r"(?P<part>[wxyz])"
_INDEX = r"q(?P<part>\[[0123]\])"
_ROS = r"(?:.*\.)?(?:orientation|rotation|quaternion)\." + _PART
_ROS_STAMP = r"(?:.*\.)?header\.stamp\.secs?"
_QUATERNION = (
    r"(?!.*(?:cov|std|var|noise|sigma|delta|error|setpoint))"
    r"(?:(?:.*[._])?(?:quaternion|quat|orientation|attitude|rotation|rot|ori|q)[._]?|"
    r"q_[a-z]+_[a-z]+_|q_[a-z]+_)" + _PART
)

ATTITUDE_DIALECTS = (
    AttitudeDialect("quatprop", r"q" + _PART, (r"t",), "ns", needs=("t_ns",)),
    AttitudeDialect("TUM", r"q" + _PART, (r"timestamp|time|t",), "s", needs=("tx", "ty", "tz")),
    AttitudeDialect("EuRoC", r"q_[a-z]+_" + _PART, (r"timestamp",), "ns"),
    *(
        AttitudeDialect("PX4 ulog2csv", _INDEX, (r"timestamp",), "us", needs=needs)
        for needs in (("rollspeed",), ("delta_q_reset[0]",), ("quat_reset_counter",))
    ),
    AttitudeDialect(
        "PX4 ulog2csv",
        _INDEX,
        (r"timestamp",),
        "us",
        needs=("q[0]",),
        file=r"vehicle_(?:attitude|odometry|visual_odometry)(?!_setpoint)",
    ),
    AttitudeDialect(
        "rostopic echo -p",
        r"field\." + _ROS,
        (r"field\.(?:.*\.)?header\.stamp", r"time"),
        "ns",
        log_time=r"time",
        needs=("%time",),
    ),
    AttitudeDialect(
        "ROS messages as columns", _ROS, (_ROS_STAMP, r"(?:.*\.)?header\.stamp"), log_time=r"time"
    ),
    AttitudeDialect("x-io", _PART + r"_element", (r"time|timestamp",)),
    AttitudeDialect("x-io", r"quaternion_" + _PART, (r"time|timestamp",)),
    AttitudeDialect("Sensor Logger", r"q" + _PART, (r"time",), "ns", needs=("seconds_elapsed",)),
)
"""Every known convention, told in this order."""

ATTITUDE_GENERIC = AttitudeDialect(
    "", _QUATERNION, (_ROS_STAMP, r"(?:stamp[._])?secs?", TIME_NAMES)
)
"""Names that clearly mean the components of a quaternion and time, but no units."""

ABSENT = r"orientation_covariance(?:\[0\]|_?0|\.0)"
"""After the prefix of a ROS orientation: a number that is -1 where there is none."""
