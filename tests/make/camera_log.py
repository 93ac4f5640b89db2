"""An MCAP file of rates with a camera, an attachment and metadata."""

from make.mcap import Topic, build
from make.ros import IMU, ROS1, ROS2, encoded
from mcap.writer import CompressionType

START = 1_700_000_000_000_000_000
BOOT = 5_000_000_000
"""The stamps count from when the recorder was switched on; log times do not."""
HEADER = "std_msgs/msg/Header"
RATE = 0.25


def imu_message(store, stamp):
    """Return an encoded message of a body that turns about z."""
    values = {
        "header": {"stamp": stamp, "frame_id": "imu"},
        "orientation": (0.0, 0.0, 0.6, 0.8),
        "angular_velocity": (0.0, 0.0, RATE),
        "linear_acceleration": (0.0, 0.0, 9.81),
    }
    return encoded(store, IMU, values)


def moments(count, start=0):
    """Return stamps and log times: 100 Hz, each logged a little later than it was measured."""
    for k in range(start, start + count):
        yield BOOT + k * 10_000_000, START + k * 10_000_000 + (k % 7) * 1000


def write_mcap(path, count=300, profile="ros2", start=0, times=None, **options):
    """Write an MCAP file of rates, a camera, an attachment and metadata.

    Stamps and log times are those of `times`, or of :func:`moments`. Every other option is that of
    the library's writer.
    """
    ros1 = profile == "ros1"
    store = ROS1 if ros1 else ROS2
    definition, _ = store.generate_msgdef(IMU, ros_version=2 - ros1)
    kind = (IMU.replace("/msg/", "/"), "ros1msg", "ros1") if ros1 else (IMU, "ros2msg", "cdr")
    imu = Topic(kind[0], (), definition.encode(), *kind[1:])
    topics = [("/imu", imu), ("/camera", Topic("", encoding="jpeg", metadata=[("lens", "wide")]))]

    def events():
        yield lambda writer: writer.add_metadata("vehicle", {"name": "truck"})
        for k, (stamp, logged) in enumerate(times or moments(count, start)):
            yield 0, logged, imu_message(store, stamp), logged + 1
            if k % 10 == 0:
                yield 1, logged, bytes([k % 256]) * 500
            if k == count // 2:
                note = (logged, 7, "calibration.yaml", "text/yaml", b"k: [1, 2]")
                yield lambda writer, note=note: writer.add_attachment(*note)
        yield lambda writer: writer.add_metadata("end", {"why": "stopped"})

    options = {"chunk_size": 4000, "compression": CompressionType.ZSTD, **options}
    path.write_bytes(build(topics, events(), profile=profile, **options))
    return path
