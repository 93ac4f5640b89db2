"""Definitions of PX4 messages, as far as they matter here, and logs of them."""

from make.mcap import Topic, write_topics
from make.ros import encoded
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

DEFINITIONS = {
    "SensorCombined": (
        "uint64 timestamp\nint32 RELATIVE_TIMESTAMP_INVALID = 2147483647\nfloat32[3] gyro_rad\n"
        "uint32 gyro_integral_dt\nint32 accelerometer_timestamp_relative\n"
        "float32[3] accelerometer_m_s2\nuint32 accelerometer_integral_dt\n"
        "uint8 accelerometer_clipping\nuint8 gyro_clipping\n"
    ),
    "SensorGyro": (
        "uint64 timestamp\nuint64 timestamp_sample\nuint32 device_id\nfloat32 x\nfloat32 y\n"
        "float32 z\nfloat32 temperature\nuint32 error_count\nuint8[3] clip_counter\nuint8 samples\n"
    ),
    "SensorGyroFifo": (
        "uint64 timestamp\nuint64 timestamp_sample\nuint32 device_id\nfloat32 dt\nfloat32 scale\n"
        "uint8 samples\nint16[32] x\nint16[32] y\nint16[32] z\n"
    ),
    "VehicleAngularVelocity": (
        "uint64 timestamp\nuint64 timestamp_sample\nfloat32[3] xyz\nfloat32[3] xyz_derivative\n"
    ),
    "VehicleImu": (
        "uint64 timestamp\nuint64 timestamp_sample\nuint32 accel_device_id\nuint32 gyro_device_id\n"
        "float32[3] delta_angle\nfloat32[3] delta_velocity\nuint32 delta_angle_dt\n"
        "uint32 delta_velocity_dt\nuint8 delta_angle_clipping\nuint8 delta_velocity_clipping\n"
        "uint8 accel_calibration_count\nuint8 gyro_calibration_count\n"
    ),
    "VehicleOdometry": (
        "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\nfloat32[3] position\n"
        "float32[4] q\nuint8 velocity_frame\nfloat32[3] velocity\nfloat32[3] angular_velocity\n"
        "float32[3] position_variance\nfloat32[3] orientation_variance\n"
        "float32[3] velocity_variance\nuint8 reset_counter\nint8 quality\n"
    ),
}


def write_mcap(path, kind, messages, definition=True):
    """Write messages, dictionaries of the fields that are not zero, as a ROS 2 MCAP file."""
    store, name = get_typestore(Stores.LATEST), f"px4_msgs/msg/{kind}"
    store.register(get_types_from_msg(DEFINITIONS[kind], name))
    written = [(int(one["timestamp"]) * 1000 + 77, encoded(store, name, one)) for one in messages]
    text = DEFINITIONS[kind].encode() if definition else b""
    topic = Topic(name, written, text, "ros2msg", "cdr")
    return write_topics(path, {f"/fmu/out/{kind}": topic}, profile="ros2")
