"""Logs as robots write them: frame ids of several lengths, a camera beside the IMU, Protobuf."""

import struct
from pathlib import Path

import numpy as np
from make.formats import protobuf_topic
from make.mcap import write_topics
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

import quatprop

STORE = get_typestore(Stores.ROS2_HUMBLE)
IMU, IMAGE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/CompressedImage"
FRAMES = ("imu", "imu_link", "body", "base_link", "gyro_left_front", "x")
T0 = 1_700_000_000_000_000_000
STEP_NS = 2_500_000
"""400 Hz."""
EVERY = 16
"""Samples between two pictures: 25 Hz."""


def varying_frames(path: Path, samples: int) -> None:
    """Write Imu messages whose frame ids have several lengths, one after another."""
    _write(path, samples, FRAMES, None)


def beside_images(path: Path, samples: int) -> None:
    """Write Imu messages beside pictures of 100 kB, plain or packed as the name says."""
    noise = np.random.default_rng(1).integers(0, 256, 100_000, np.uint8)
    _write(path, samples, FRAMES[:1], _encoded(IMAGE, "camera", "jpeg", noise))


def odometry(path: Path, samples: int) -> None:
    """Write the rates of the table beside it as messages of Protobuf."""
    rates = quatprop.read_rates(path.with_name("imu.parquet"))[:samples]
    write_topics(path, {"/odometry": protobuf_topic(rates)})


def _write(path: Path, samples: int, frames: tuple[str, ...], image: bytes | None) -> None:
    vector, zeros = STORE.types["geometry_msgs/msg/Vector3"], np.zeros(9)
    attitude = STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    values = attitude, zeros, vector(0.1, 0.2, 0.3), zeros, vector(0.0, 0.0, 9.8), zeros
    templates = [bytearray(_encoded(IMU, frame, *values)) for frame in frames]
    packed = CompressionType.ZSTD if "zstd" in path.name else CompressionType.NONE
    with path.open("wb") as file:
        writer = Writer(file, compression=packed)
        writer.start("ros2", "bench")
        channels = []
        for topic, name in (("/imu", IMU), ("/camera", IMAGE)):
            text, _ = STORE.generate_msgdef(name)
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channels.append(writer.register_channel(topic, "cdr", schema))
        for number in range(samples):
            t_ns = T0 + number * STEP_NS
            message = templates[number % len(frames)]
            struct.pack_into("<II", message, 4, *divmod(t_ns, 10**9))
            writer.add_message(channels[0], t_ns, bytes(message), t_ns)
            if image and number % EVERY == 0:
                writer.add_message(channels[1], t_ns, image, t_ns)
        writer.finish()


def _encoded(name: str, frame: str, *values: object) -> bytes:
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), frame)
    return bytes(STORE.serialize_cdr(types[name](header, *values), name))
