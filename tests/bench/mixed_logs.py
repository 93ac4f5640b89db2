"""Logs as robots write them: frame ids of several lengths, a camera next to the IMU, Protobuf."""

import struct
from pathlib import Path

import numpy as np
from make.formats import protobuf_topic
from make.mcap import Topic, write, write_topics
from make.ros import IMU, ROS2, encoded
from mcap.writer import CompressionType

import quatprop

IMAGE = "sensor_msgs/msg/CompressedImage"
FRAMES = ("imu", "imu_link", "body", "base_link", "gyro_left_front", "x")
T0 = 1_700_000_000_000_000_000
STEP_NS = 2_500_000
"""400 Hz."""
EVERY = 16
"""Samples between two pictures: 25 Hz."""


def varying_frames(path: Path, samples: int) -> None:
    """Write Imu messages whose frame ids have several lengths, one after another."""
    _write(path, samples, FRAMES, None)


def with_images(path: Path, samples: int) -> None:
    """Write Imu messages next to pictures of 100 kB, plain or packed as the name says."""
    noise = np.random.default_rng(1).integers(0, 256, 100_000, np.uint8)
    image = {"header": {"frame_id": "camera"}, "format": "jpeg", "data": noise}
    _write(path, samples, FRAMES[:1], encoded(ROS2, IMAGE, image))


def odometry(path: Path, samples: int) -> None:
    """Write the rates of the table next to it as messages of Protobuf."""
    rates = quatprop.read_rates(path.with_name("imu.parquet"))[:samples]
    write_topics(path, {"/odometry": protobuf_topic(rates)})


def _write(path: Path, samples: int, frames: tuple[str, ...], image: bytes | None) -> None:
    turning = {"orientation": (0.0, 0.0, 0.0, 1.0), "angular_velocity": (0.1, 0.2, 0.3)}
    values = [{"header": {"frame_id": frame}, **turning} for frame in frames]
    templates = [bytearray(encoded(ROS2, IMU, one)) for one in values]
    topics = []
    for topic, kind in (("/imu", IMU), ("/camera", IMAGE)):
        text, _ = ROS2.generate_msgdef(kind, ros_version=2)
        topics.append((topic, Topic(kind, (), text.encode(), "ros2msg", "cdr")))

    def events():
        for number in range(samples):
            t_ns = T0 + number * STEP_NS
            message = templates[number % len(frames)]
            struct.pack_into("<II", message, 4, *divmod(t_ns, 10**9))
            yield 0, t_ns, bytes(message)
            if image and number % EVERY == 0:
                yield 1, t_ns, image

    packed = CompressionType.ZSTD if "zstd" in path.name else CompressionType.NONE
    with path.open("wb") as file:
        write(file, topics, events(), profile="ros2", compression=packed)
