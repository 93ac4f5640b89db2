"""The vocabulary: one row for each message type and program.

A new device is one new row of :data:`ROWS`, for its messages and its files alike. Names are regular
expressions for whole names of columns, as spelled or as keys (lower case, without unit); in
messages they are relative to the struct of the row's type, which may be nested. The group ``part``
of a pattern is the component; the rest of the name must be the same for all components.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from quatprop.readers.messages.schema import ros_name
from quatprop.readers.tables.table_log import (
    EULER,
    EULER_NUMBERED,
    GYROSCOPE,
    NOT_ATTITUDE,
    NOT_RATE,
    NOT_ROTATION,
    ROTATION_VECTOR,
    TIME_NAMES,
)
from quatprop.settings.quantities import EULER_SEQUENCES

if TYPE_CHECKING:
    from collections.abc import Mapping


# The row type of the vocabulary: patterns for names of columns, and their meaning.


class Burst(NamedTuple):
    """Fields of a message with several samples; its timestamp is that of the last sample.

    `samples`: number of samples in the arrays, the oldest first
    `scale`: scale factor of the stored numbers
    `spacing`: time between samples, in the unit of the timestamps
    """

    samples: str
    scale: str
    spacing: str


class Row(NamedTuple):
    """Names of the columns of one source, and the meaning of their numbers.

    `name`: name in summaries; ``""`` if files have other names than messages, as with ROS
    `types`: message types, as ROS spells them
    `rate`, `quat`, `bias`, `force`: patterns of the components of a rate, quaternion, gyroscope
        bias and specific force
    `stamps`: timestamps, the best first: times, or numbers in the `time_unit`. In a file, the
        nanoseconds of ``sec`` or ``secs`` are in another column
    `unit`: unit of the rate and the bias; ``""``: names must declare it
    `time_unit`: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; ``""``: times have their own unit
    `absent`: suffix of the column that is -1 if a quantity is absent
    `valid`: column that is false if a bias is not valid
    `position`: pattern of the components of the position of the same body, m
    `covariance`: pattern of the 9 or 36 numbers of the covariance of the attitude about the axes of
        the reference frame, rad^2; of 36, the last 3x3 block is used
    `layout`: ``"scalar-first"`` or ``"scalar-last"`` for a quaternion without named components
    `frames`: frames of body and reference, if the type fixes them; all that do have z down
    `axes`: the frame about whose axes the rate is, if not those of the body
    `measured`: whether the rate is measured; estimated and commanded ones have a lower priority
    `method`: integration rule that the definition implies: ``"end"`` for averages over the interval
        before the timestamp
    `span`: integration time, in the `time_unit`, if the rate is an increment, rad, over the
        interval before the timestamp
    `burst`: fields of a message with several samples; `rate` matches the components of all
    `angles`, `angle_unit`: pattern of Euler angles, and their unit if names do not declare it
    `needs`: further columns, or the first line, that identify a file
    `file`: pattern to be found in the file name, if columns do not identify it
    `log_time`: column of the time of recording, if a file has one besides the header timestamp
    """

    name: str = ""
    types: tuple[str, ...] = ()
    rate: str = ""
    quat: str = ""
    bias: str = ""
    force: str = ""
    stamps: tuple[str, ...] = ("header.stamp",)
    unit: str = "rad/s"
    time_unit: str = ""
    absent: str = ""
    valid: str = ""
    position: str = ""
    covariance: str = ""
    layout: str = ""
    frames: str = ""
    axes: str = ""
    measured: bool = True
    method: str | None = None
    span: str = ""
    burst: Burst | None = None
    angles: str = ""
    angle_unit: str = ""
    needs: tuple[str, ...] = ()
    file: str = ""
    log_time: str = ""


XYZ = r"[.\[](?P<part>[xyz012])\]?"
"""Component of a vector: a field or an array element."""
WXYZ = r"[.\[](?P<part>[wxyz0123])\]?"

RATE_PARTS = ("x|p|0|[0]|roll", "y|q|1|[1]|pitch", "z|r|2|[2]|yaw")
"""Spellings of each axis in the group ``part``."""
QUATERNION_PARTS = ("w|0", "x|1", "y|2", "z|3")
"""Spellings of each component of a quaternion in the group ``part``."""
PARTS: Mapping[str, tuple[str, ...]] = {
    "rate": RATE_PARTS,
    "quat": QUATERNION_PARTS,
    "bias": RATE_PARTS,
    "force": RATE_PARTS,
    "position": RATE_PARTS,
    "angles": ("yaw|z", "pitch|y", "roll|x"),
}
"""Field of a row -> spellings of its components."""

ABSENT = r"_covariance(?:\[0\]|_?0|\.0)"
"""First element of a ROS covariance: -1 if the quantity is absent."""

STAMPS = ("header.stamp", "stamp", "timestamp")
"""Fields that may be the timestamp of any message."""


# Names of columns that mean a quantity in any table; those of single sources are in the rows.
#
# Their units have to be declared. Numbered components of a quaternion do not tell which one is the
# scalar, so they are only matched in rows for sources where this is known.


COMPONENT = r"(?P<part>[wxyz])"
"""A component; by itself, it means a quaternion only if the user says so."""

SENSOR = (
    r"(?!.*sub_?frame)(?:.*[._])?(?:sensor|device|imu|frame|instance|node|module|source|location|placement|side"
    r"|hand|segment|body_part|serial|mac|address|port|unit)(?:_?(?:id|name|type|no|num|number|index))?"
    r"|id|kind|topic|type|name|msg|message|tag|channel|(?:.*\.)?i"
)
"""Names of columns that may identify the sensor of a row, such as ``I`` in ArduPilot logs; not the
``Sub Frame`` of Vicon, which counts samples within a frame."""
WITH_RATE_UNIT = tuple(
    rf"{NOT_RATE}(?:.*[^a-z])?[a-z]?(?P<part>[{axes}])(?:[^a-z].*)?" for axes in ("xyz", "pqr")
)
"""Names of an axis, or a body rate in flight mechanics, that are rates if their unit is one."""
BARE_RATES = ("g_?(?P<part>[xyz])", r"(?P<part>[pqr])")
"""Names that are body rates if the user declares the unit of rates."""
OTHER_BARE_NAMES = r"(?:a|acc\w*|m|mag\w*)_?[xyz]"
"""Axes of other sensors of the same device."""
ANGLE_RATES = (
    rf"{NOT_RATE}(?:.*[^a-z])?(?P<part>roll|pitch|yaw)(?:[^a-z].*|rate|speed|velocity)?",
    rf"{NOT_RATE}(?:.*[._])?(?:rate|gyro)_?(?P<part>roll|pitch|yaw)",
)
"""Names of rates about axes that may be those of the body, or others."""
QUATERNION = (
    rf"{NOT_ATTITUDE}(?:(?:.*[._])?(?:quaternion|quat|orientation|attitude|rotation|rot|ori|q)"
    rf"[._]?|q_[a-z]+_[a-z]+_|q_[a-z]+_){COMPONENT}"
)
NUMBERED_QUATERNION = r"(?:.*[._])?(?:quaternion|quat|orientation|q)[._]?\[?(?P<part>[0-4])\]?"
"""Names that do not tell which component is the scalar, and may mean something else."""
_MATRIX = (
    NOT_ROTATION + r"(?:.*[._])?(?:r|m|mat|rot|rotation|matrix|dcm)_?"
    r"\[?(?P<part>[{0}](?:_|\]\[)?[{0}])\]?"
)

BIAS = (
    r"(?:.*[._])?(?:gyro(?:scope)?_?bias|bias_?gyro(?:scope)?|b_?g)[._]?"
    r"(?P<part>[xyz]|\[[012]\])"
)
FORCE = (
    r"(?:.*\.)?(?:a_rs_s_|(?:accelerometer_?)?acc(?:el(?:eration|erometer)?)?[ _]?|"
    r"linear_acceleration\.|accelerometer_m_s2\[?|a)(?P<part>[xyz012])\]?(?:_(?:m?g|m_?p?s_?2))?"
)
REVERSED_FORCE = r"accelerometerAcceleration(?P<part>[XYZ])\(G\)"
"""Columns of SensorLog, which writes what iOS gives: minus the force, so -1 upward in a body at
rest."""
POSITION = r"(?:t|(?:.*\.)?(?:position|translation)\.|p_[a-z]+_[a-z]+_)(?P<part>[xyz])"
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
"""Representation, pattern and spellings of the components of attitudes except quaternions."""


_SEGMENT = (
    r"(?:Pelvis|L5|L3|T12|T8|Neck|Head|(?:Right|Left) (?:Shoulder|Upper Arm|Forearm|Hand|Upper Leg"
    "|Lower Leg|Foot|Toe))"
)


def _of_segment(quantity: str) -> str:
    """Return the pattern of a quantity of a segment of MVN's model, as it spells them."""
    return rf"(?:{_SEGMENT} {quantity}|Segment {quantity} {_SEGMENT}) "


_AXIS, _PART = "(?P<part>[xyz])", "(?P<part>[wxyz])"
_ros = partial(Row, absent=ABSENT)
_foxglove = partial(Row, stamps=("timestamp",))
_px4 = partial(
    Row,
    "PX4 ulog2csv",
    stamps=("timestamp_sample", "timestamp"),
    time_unit="us",
    frames="FRD body to NED reference",
)
_frd = partial(_px4, quat="q" + WXYZ, layout="scalar-first")
_sensor_logger = partial(
    Row, "Sensor Logger", stamps=("time",), time_unit="ns", needs=("seconds_elapsed",)
)

_rostopic = partial(
    Row,
    "rostopic echo -p",
    stamps=(r"field\.(?:.*\.)?header\.stamp", "time"),
    time_unit="ns",
    absent=ABSENT,
    log_time="time",
    needs=("%time",),
)
_ros_columns = partial(
    Row,
    "ROS messages as columns",
    stamps=(r"(?:.*\.)?header\.stamp\.secs?", r"(?:.*\.)?header\.stamp"),
    absent=ABSENT,
    log_time="time",
)

_OF_MESSAGES = (
    _ros(
        types=("sensor_msgs/msg/Imu",),
        rate="angular_velocity" + XYZ,
        quat="orientation" + WXYZ,
        force="linear_acceleration" + XYZ,
        covariance=r"orientation_covariance\[\d\]",
    ),
    _ros(types=("geometry_msgs/msg/QuaternionStamped",), quat="quaternion" + WXYZ),
    _ros(
        types=("geometry_msgs/msg/PoseStamped",),
        quat=r"pose\.orientation" + WXYZ,
        position=r"pose\.position" + XYZ,
    ),
    _ros(
        types=("geometry_msgs/msg/PoseWithCovarianceStamped",),
        quat=r"pose\.pose\.orientation" + WXYZ,
        position=r"pose\.pose\.position" + XYZ,
        covariance=r"pose\.covariance\[\d+\]",
    ),
    _ros(
        types=("geometry_msgs/msg/TransformStamped",),
        quat=r"transform\.rotation" + WXYZ,
        position=r"transform\.translation" + XYZ,
    ),
    _ros(types=("geometry_msgs/msg/TwistStamped",), rate=r"twist\.angular" + XYZ, measured=False),
    _ros(
        types=("geometry_msgs/msg/TwistWithCovarianceStamped",),
        rate=r"twist\.twist\.angular" + XYZ,
        measured=False,
    ),
    _ros(types=("geometry_msgs/msg/Vector3Stamped",), bias="vector" + XYZ),
    _ros(
        types=("nav_msgs/msg/Odometry",),
        rate=r"twist\.twist\.angular" + XYZ,
        quat=r"pose\.pose\.orientation" + WXYZ,
        position=r"pose\.pose\.position" + XYZ,
        covariance=r"pose\.covariance\[\d+\]",
        measured=False,
    ),
    _foxglove(
        types=("foxglove_msgs/msg/FrameTransform",),
        quat="rotation" + WXYZ,
        position="translation" + XYZ,
    ),
    _foxglove(
        types=("foxglove_msgs/msg/Odometry",),
        rate="angular_velocity" + XYZ,
        quat=r"pose\.orientation" + WXYZ,
        position=r"pose\.position" + XYZ,
        measured=False,
    ),
    _foxglove(
        types=("foxglove_msgs/msg/PoseInFrame",),
        quat=r"pose\.orientation" + WXYZ,
        position=r"pose\.position" + XYZ,
    ),
)

_PX4 = (
    _px4(
        types=("px4_msgs/msg/EstimatorSensorBias", "px4_msgs/msg/SensorBias"),
        bias="gyro_bias" + XYZ,
        valid="gyro_bias_valid",
    ),
    _px4(
        types=("px4_msgs/msg/SensorCombined",),
        rate="gyro_rad" + XYZ,
        force="accelerometer_m_s2" + XYZ,
        method="end",
    ),
    _frd(rate="(?P<part>roll|pitch|yaw)speed", needs=("rollspeed", "q[0]", "q[3]")),
    _px4(
        types=("px4_msgs/msg/VehicleAngularVelocity",),
        rate="xyz" + XYZ,
        file="vehicle_angular_velocity",
    ),
    _px4(
        types=("px4_msgs/msg/SensorGyro",),
        rate=_AXIS,
        needs=("device_id",),
        file=r"sensor_gyro(?!_fifo)",
    ),
    _px4(
        types=("px4_msgs/msg/SensorGyroFifo",),
        rate=_AXIS + r"\[\d+\]",
        burst=Burst("samples", "scale", "dt"),
        needs=("samples", "scale", "dt"),
    ),
    _px4(
        types=("px4_msgs/msg/VehicleImu",),
        rate="delta_angle" + XYZ,
        span="delta_angle_dt",
        needs=("delta_angle_dt",),
    ),
    _frd(types=("px4_msgs/msg/VehicleAttitude",), needs=("delta_q_reset[0]",)),
    _frd(
        types=("px4_msgs/msg/VehicleOdometry",),
        rate="angular_velocity" + XYZ,
        position="position" + XYZ,
        measured=False,
        file=r"vehicle_(?:visual_)?odometry",
    ),
    _frd(needs=("quat_reset_counter",)),
    _frd(file=r"vehicle_attitude(?!_setpoint)"),
)

_OF_FILES = (
    Row(
        "quatprop",
        rate="w" + _AXIS,
        quat="q" + _PART,
        stamps=("t",),
        time_unit="ns",
        needs=("t_ns",),
    ),
    Row(
        "TUM",
        quat="q" + _PART,
        stamps=("timestamp|time|t",),
        time_unit="s",
        needs=("tx", "ty", "tz"),
    ),
    Row(
        "EuRoC",
        # Resolved in the frame of the sensor, which turns.
        rate=r"w_[a-z]+?([a-z]+)_\1_" + _AXIS,
        quat=r"q_[a-z]+_" + _PART,
        bias=r"b_w_[a-z]+_[a-z]+_" + _AXIS,
        stamps=("timestamp",),
        time_unit="ns",
    ),
    *_PX4,
    _rostopic(
        rate=rf"field\.(?:.*\.)?angular_velocity\.{_AXIS}",
        quat=rf"field\.(?:.*\.)?(?:orientation|rotation|quaternion)\.{_PART}",
    ),
    _rostopic(rate=rf"field\.(?:.*\.)?twist\.angular\.{_AXIS}", measured=False),
    _ros_columns(
        rate=rf"(?:.*\.)?angular_velocity\.{_AXIS}",
        quat=rf"(?:.*\.)?(?:orientation|rotation|quaternion)\.{_PART}",
    ),
    _ros_columns(rate=rf"(?:.*\.)?twist\.angular\.{_AXIS}", measured=False),
    Row(
        "ArduPilot",
        rate="gyr_" + _AXIS,
        angles=EULER,
        angle_unit="deg",
        stamps=("time",),
        time_unit="us",
        needs=("timeus",),
    ),
    Row(
        "Betaflight",
        rate="gyro_adc" + XYZ,
        unit="deg/s",
        stamps=("time",),
        time_unit="us",
        needs=("loopiteration",),
    ),
    Row(
        "Android GnssLogger",
        rate="uncal_gyro_" + _AXIS,
        unit="",
        stamps=("elapsed_realtime_nanos",),
        time_unit="ns",
        needs=("elapsedrealtimenanos",),
    ),
    Row("gcsv", rate="g" + _AXIS, stamps=("t",), needs=("gyroflow imu log",)),
    Row(
        "phyphox",
        rate="gyroscope_" + _AXIS,
        unit="",
        stamps=("time",),
        needs=("gyroscope x (rad/s)",),
    ),
    _sensor_logger(rate=_AXIS, file="(?i)gyroscope"),
    _sensor_logger(rate="rotation_rate_" + _AXIS, quat="quaternion_" + _PART),
    _sensor_logger(quat="q_?" + _PART),
    Row(
        "x-io",
        rate="gyroscope_" + _AXIS,
        quat=_PART + "_element",
        unit="",
        stamps=("time|timestamp",),
    ),
    Row("x-io", quat="quaternion_" + _PART, stamps=("time|timestamp",)),
    Row(
        "TUM-VI",
        rate=r"w\." + _AXIS,
        stamps=("timestamp",),
        time_unit="ns",
        needs=("a.x", "a.y", "a.z"),
    ),
    Row(
        "Project Aria",
        rate=f"angular_velocity_{_AXIS}_device",
        quat=f"q{_PART}_(?:world|odometry)_device",
        stamps=("tracking_timestamp",),
        time_unit="us",
    ),
    Row(
        "BROAD",
        rate="imu_gyr" + XYZ,
        quat="opt_quat" + WXYZ,
        force="imu_acc" + XYZ,
        layout="scalar-first",
        stamps=(),
        needs=("imu_gyr[0]", "imu_acc[0]", "opt_quat[3]"),
    ),
    Row("NGIMU", quat=_PART, stamps=("time|timestamp",), file="(?i)quaternion"),
    # MT Manager's tables have these rates and stamps in other units, and no such columns.
    *(
        Row(
            "Movella DOT",
            rate="gyr_" + _AXIS,
            quat="quat_" + _PART,
            angles="euler_" + _AXIS,
            unit="deg/s",
            angle_unit="deg",
            stamps=("sample_time_fine",),
            time_unit="us",
            needs=(column,),
        )
        for column in ("quat_w", "euler_x")
    ),
    Row("Xsens", quat="quat_q(?P<part>[0123])", layout="scalar-first", stamps=()),
    # As it spells the segments of its model, whose rates are about axes of the world.
    Row(
        "Xsens MVN",
        rate=_of_segment("Angular Velocity") + r"(?P<part>[xyz])\b.*",
        quat=_of_segment("Orientation") + "q(?P<part>[0123])",
        layout="scalar-first",
        axes="world",
        stamps=(),
    ),
)

ROWS = (*_OF_MESSAGES, *_OF_FILES)
"""The rows, in the order in which files are tried. The states of PX4's estimator have no row as a
bias: in older versions they contain the bias of an angle, in newer ones of a rate, without telling
which."""

GENERIC = Row(
    rate=GYROSCOPE,
    quat=QUATERNION,
    bias=BIAS,
    force=FORCE,
    position=POSITION,
    absent=ABSENT,
    unit="",
    stamps=(r"(?:.*\.)?header\.stamp\.secs?", r"(?:stamp[._])?secs?", TIME_NAMES),
)
"""Names that clearly mean a quantity or the time, without units."""

TYPES = {name: row for row in ROWS for name in row.types}
"""The row of each message type."""


def row_of_type(type_name: str) -> Row | None:
    """Return the row of a message type, in any spelling of ROS or Foxglove."""
    return TYPES.get(ros_name(type_name).replace("foxglove/", "foxglove_msgs/"))
