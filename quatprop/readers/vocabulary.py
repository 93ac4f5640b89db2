"""The vocabulary: one row for each message type and program.

A new device is one new row of :data:`ROWS`, for its messages and its files alike. Names are regular
expressions for whole names of columns, as spelled or as keys (lower case, without unit); in
messages they are relative to the struct of the row's type, which may be nested. The group ``part``
of a pattern is the component; the rest of the name must be the same for all components.
"""

from __future__ import annotations

from functools import partial

from quatprop.logs.vocabulary.names import BIAS, FORCE, POSITION, QUATERNION
from quatprop.logs.vocabulary.rows import ABSENT, WXYZ, XYZ, Burst, Row
from quatprop.messages.schema import ros_name
from quatprop.tables.column_names import EULER, GYROSCOPE, TIME_NAMES

_AXIS, _PART = "(?P<part>[xyz])", "(?P<part>[wxyz])"
_ros = partial(Row, absent=ABSENT)
_foxglove = partial(Row, stamps=("timestamp",))
_px4 = partial(Row, "PX4 ulog2csv", stamps=("timestamp_sample", "timestamp"), time_unit="us")
_frd = partial(_px4, quat="q" + WXYZ, layout="scalar-first", frames="FRD body to NED reference")
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
        rate=r"w_[a-z]+_[a-z]+_" + _AXIS,
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
