"""Conventions of tables: how columns of time, rates and attitudes are named, and in what units.

A new convention is one entry of :data:`DIALECTS`. Beyond them, names that clearly mean gyroscope
axes, an attitude or time are recognised (:data:`GENERIC`), but their units only where the header
declares them. Quaternion components that are numbered do not say which is the scalar: only a
convention that is certain about it is trusted with those.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from quatprop.settings import EULER_SEQUENCES


class Dialect(NamedTuple):
    """How one source of tables names its columns.

    Patterns are regular expressions for whole
    :attr:`quatprop.tables.matching.column_names.ColumnName.key` values.

    Parameters
    ----------
    name
        What the summary calls it.
    rate, quaternion, bias
        The columns of each; the group ``part`` is the component, the rest of the name must be the
        same in all of them. ``""`` where it has none.
    time
        Time columns, the preferred one first. A column ``sec`` or ``secs`` has its nanoseconds
        in a column beside it.
    rate_unit, time_unit
        Units by convention, where the header does not declare them; ``""`` where it must.
    log_time
        The column of the time of recording, if there is one beside the message's own stamp.
    needs
        Further columns, or the first line of the file, by which the convention is recognised.
    file
        Pattern found in the name of the file, where columns alone are not enough.
    method
        The integration rule that fits the samples, where the convention defines it: ``"end"`` for
        averages over the interval before the stamp.
    angles, angle_unit
        The columns of Euler angles, and their unit where names do not declare it.
    """

    name: str
    rate: str = ""
    quaternion: str = ""
    time: tuple[str, ...] = ()
    rate_unit: str = ""
    time_unit: str = ""
    log_time: str = ""
    needs: tuple[str, ...] = ()
    file: str = ""
    method: str | None = None
    bias: str = ""
    angles: str = ""
    angle_unit: str = ""


_XYZ = r"(?P<part>[xyz])"
COMPONENT = r"(?P<part>[wxyz])"
"""A name that is a component alone means a quaternion only where a user says so."""
_INDEX = r"\[(?P<part>[012])\]"
_Q_INDEX = r"q\[(?P<part>[0123])\]"
_ROS_RATE = r"(?:.*\.)?(?:angular_velocity|twist\.angular)\." + _XYZ
_ROS_QUATERNION = r"(?:.*\.)?(?:orientation|rotation|quaternion)\." + COMPONENT
_ROS_STAMP = r"(?:.*\.)?header\.stamp\.secs?"

TIME_NAMES = r"_*(?:t|ts|time|timestamp|time_?stamp|stamp)"
SENSOR = (
    r"(?:.*[._])?(?:sensor|device|imu|frame|instance|node|module|source|location|placement|side"
    r"|hand|segment|body_part|serial|mac|address|port|unit)(?:_?(?:id|name|type|no|num|number|index))?"
    r"|id|kind|topic|type|name|msg|message|tag|channel|(?:.*\.)?i"
)
"""Names of a column that may say which sensor a row is of, such as ``I`` of ArduPilot."""
_NOT_RATE = r"(?!b_w_|.*(?:bias|cov|std|var|noise|drift|offset|error|setpoint))"
_GYROSCOPE = (
    r"(?:gyro(?:scopes?|_?rate)?|gyr|omega|ang(?:ular)?_?(?:velocity|vel|rate)|rotation_?rate)"
)
GYROSCOPE = rf"{_NOT_RATE}(?:(?:.*[._])?{_GYROSCOPE}[._]?|w[._]?)(?P<part>[xyz]|\[[012]\])"
AXIS_FIRST = rf"{_NOT_RATE}(?:.*[._])?(?P<part>[xyz])_?{_GYROSCOPE}(?:_out)?"
WITH_RATE_UNIT = tuple(
    rf"{_NOT_RATE}(?:.*[^a-z])?[a-z]?(?P<part>[{axes}])(?:[^a-z].*)?" for axes in ("xyz", "pqr")
)
"""Names of an axis, or of a body rate of flight mechanics, whose unit says that it is a rate."""
BARE_RATES = ("g_?" + _XYZ, r"(?P<part>[pqr])")
"""Names that may be body rates, and are where the user declares the unit of rates."""
BESIDE_BARE_RATES = r"(?:a|acc\w*|m|mag\w*)_?[xyz]"
"""Axes of other sensors of the same device."""
_NOT_ATTITUDE = r"(?!.*(?:cov|std|var|noise|sigma|delta|error|setpoint))"
_NOT_ROTATION = (
    _NOT_ATTITUDE + r"(?!.*(?:rate|speed|vel|acc|omega|gyr))(?!(?:.*[._])?des(?:ired)?[._])"
)
_QUATERNION = (
    rf"{_NOT_ATTITUDE}(?:(?:.*[._])?(?:quaternion|quat|orientation|attitude|rotation|rot|ori|q)"
    rf"[._]?|q_[a-z]+_[a-z]+_|q_[a-z]+_){COMPONENT}"
)
ROTATION_VECTOR = (
    rf"{_NOT_ROTATION}(?:.*[._])?(?:rotvec|rotation_?vector|rot_?vec)[._]?(?P<part>[xyz])"
)
EULER = rf"{_NOT_ROTATION}(?:.*[._])?(?P<part>yaw|pitch|roll)"
EULER_NUMBERED = _NOT_ROTATION + r"(?:.*[._])?euler_{}_(?P<part>[123])"
_MATRIX = (
    _NOT_ROTATION + r"(?:.*[._])?(?:r|m|mat|rot|rotation|matrix|dcm)_?"
    r"\[?(?P<part>[{0}](?:_|\]\[)?[{0}])\]?"
)

_px4 = partial(
    Dialect,
    "PX4 ulog2csv",
    time=("timestamp_sample", "timestamp"),
    rate_unit="rad/s",
    time_unit="us",
)
_sensor_logger = partial(
    Dialect,
    "Sensor Logger",
    time=("time",),
    rate_unit="rad/s",
    time_unit="ns",
    needs=("seconds_elapsed",),
)

DIALECTS = (
    Dialect("quatprop", "w" + _XYZ, "q" + COMPONENT, ("t",), "rad/s", "ns", needs=("t_ns",)),
    Dialect("TUM", "", "q" + COMPONENT, ("timestamp|time|t",), "", "s", needs=("tx", "ty", "tz")),
    Dialect(
        "EuRoC",
        r"w_[a-z]+_[a-z]+_" + _XYZ,
        r"q_[a-z]+_" + COMPONENT,
        ("timestamp",),
        "rad/s",
        "ns",
        bias=r"b_w_[a-z]+_[a-z]+_" + _XYZ,
    ),
    _px4(bias="gyro_bias" + _INDEX),
    _px4("gyro_rad" + _INDEX, method="end"),
    _px4("(?P<part>roll|pitch|yaw)speed", _Q_INDEX, needs=("rollspeed", "q[0]", "q[3]")),
    _px4("xyz" + _INDEX, file="vehicle_angular_velocity"),
    _px4(_XYZ, needs=("device_id",), file=r"sensor_gyro(?!_fifo)"),
    _px4(quaternion=_Q_INDEX, needs=("delta_q_reset[0]",)),
    _px4(quaternion=_Q_INDEX, needs=("quat_reset_counter",)),
    _px4(quaternion=_Q_INDEX, file=r"vehicle_(?:attitude|odometry|visual_odometry)(?!_setpoint)"),
    Dialect(
        "rostopic echo -p",
        r"field\." + _ROS_RATE,
        r"field\." + _ROS_QUATERNION,
        (r"field\.(?:.*\.)?header\.stamp", "time"),
        "rad/s",
        "ns",
        log_time="time",
        needs=("%time",),
    ),
    Dialect(
        "ROS messages as columns",
        _ROS_RATE,
        _ROS_QUATERNION,
        (_ROS_STAMP, r"(?:.*\.)?header\.stamp"),
        "rad/s",
        log_time="time",
    ),
    Dialect(
        "ArduPilot",
        "gyr_" + _XYZ,
        time=("time",),
        rate_unit="rad/s",
        time_unit="us",
        needs=("timeus",),
        angles=EULER,
        angle_unit="deg",
    ),
    Dialect(
        "Betaflight", "gyro_adc" + _INDEX, "", ("time",), "deg/s", "us", needs=("loopiteration",)
    ),
    Dialect(
        "Android GnssLogger",
        "uncal_gyro_" + _XYZ,
        time=("elapsed_realtime_nanos",),
        time_unit="ns",
        needs=("elapsedrealtimenanos",),
    ),
    Dialect("gcsv", "g" + _XYZ, time=("t",), rate_unit="rad/s", needs=("gyroflow imu log",)),
    Dialect("phyphox", "gyroscope_" + _XYZ, time=("time",), needs=("gyroscope x (rad/s)",)),
    _sensor_logger(_XYZ, file="(?i)gyroscope"),
    _sensor_logger("rotation_rate_" + _XYZ, "quaternion_" + COMPONENT),
    _sensor_logger(quaternion="q_?" + COMPONENT),
    Dialect("x-io", "gyroscope_" + _XYZ, COMPONENT + "_element", ("time|timestamp",)),
    Dialect("x-io", quaternion="quaternion_" + COMPONENT, time=("time|timestamp",)),
    Dialect(
        "TUM-VI", r"w\." + _XYZ, "", ("timestamp",), "rad/s", "ns", needs=("a.x", "a.y", "a.z")
    ),
    Dialect(
        "Project Aria",
        f"angular_velocity_{_XYZ}_device",
        f"q{COMPONENT}_(?:world|odometry)_device",
        ("tracking_timestamp",),
        "rad/s",
        "us",
    ),
    Dialect("Xsens", quaternion=r"quat_q(?P<part>[0123])"),
)
"""The conventions, tried in this order."""

GENERIC = Dialect(
    "",
    GYROSCOPE,
    _QUATERNION,
    (_ROS_STAMP, r"(?:stamp[._])?secs?", TIME_NAMES),
    bias=r"(?:.*[._])?(?:gyro(?:scope)?_?bias|bias_?gyro(?:scope)?|b_?g)[._]?"
    r"(?P<part>[xyz]|\[[012]\])",
)
"""Names that clearly mean a quantity and time, but declare no units."""

ROTATIONS = (
    ("rotvec", ROTATION_VECTOR, ("x", "y", "z")),
    ("euler-zyx", EULER, ("yaw", "pitch", "roll")),
    *(
        (f"euler-{sequence}", EULER_NUMBERED.format(sequence), ("1", "2", "3"))
        for sequence in EULER_SEQUENCES
    ),
    *(
        (
            "matrix",
            _MATRIX.format(i),
            tuple(f"{row}{column}|{row}_{column}|{row}][{column}" for row in i for column in i),
        )
        for i in ("123", "012")
    ),
)
"""Representation, pattern and spellings of the components of attitudes that are no quaternions."""

RATE_PARTS = ("x|p|0|[0]|roll", "y|q|1|[1]|pitch", "z|r|2|[2]|yaw")
"""What the group ``part`` of each rate axis may be."""

QUATERNION_PARTS = ("w|0", "x|1", "y|2", "z|3")
"""What the group ``part`` of each quaternion component may be."""

COVARIANCE = r"_covariance(?:\[0\]|_?0|\.0)"
"""After the name of a ROS orientation or rate: a number that is -1 where there is none."""
