"""Logs as robots write them: frame ids of several lengths, and a camera beside the IMU."""

import struct
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
IMU, IMAGE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/CompressedImage"
FRAMES = ("imu", "imu_link", "body", "base_link", "gyro_left_front", "x")
PICTURE = 100_000
T0 = 1_700_000_000_000_000_000
STEP_NS = 2_500_000
"""400 Hz."""
EVERY = 16
"""Samples between two pictures: 25 Hz."""


def varying_frames(path: Path, samples: int) -> None:
    """Write Imu messages whose frame ids have several lengths, one after another."""
    _write(path, samples, FRAMES, CompressionType.ZSTD, picture=0)


def beside_images(path: Path, samples: int) -> None:
    """Write Imu messages beside pictures of 100 kB, plain or packed as the name says."""
    packed = CompressionType.ZSTD if "zstd" in path.name else CompressionType.NONE
    _write(path, samples, FRAMES[:1], packed, picture=PICTURE)


def _write(
    path: Path, samples: int, frames: tuple[str, ...], packed: CompressionType, picture: int
) -> None:
    templates = [bytearray(_imu(frame)) for frame in frames]
    image = _image(picture)
    with path.open("wb") as file:
        writer = Writer(file, compression=packed)
        writer.start("ros2", "bench")
        imu, camera = (
            writer.register_channel(topic, "cdr", _schema(writer, name))
            for topic, name in (("/imu", IMU), ("/camera", IMAGE))
        )
        for number in range(samples):
            t_ns = T0 + number * STEP_NS
            message = templates[number % len(frames)]
            struct.pack_into("<II", message, 4, *divmod(t_ns, 10**9))
            writer.add_message(imu, t_ns, bytes(message), t_ns)
            if picture and number % EVERY == 0:
                writer.add_message(camera, t_ns, image, t_ns)
        writer.finish()


def _schema(writer: Writer, name: str) -> int:
    text, _ = STORE.generate_msgdef(name)
    return writer.register_schema(name, "ros2msg", text.encode())


def _header(frame: str) -> object:
    types = STORE.types
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), frame)


def _imu(frame: str) -> bytes:
    types = STORE.types
    vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    attitude = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    rate, force = vector(0.1, 0.2, 0.3), vector(0.0, 0.0, 9.8)
    message = types[IMU](_header(frame), attitude, zeros, rate, zeros, force, zeros)
    return bytes(STORE.serialize_cdr(message, IMU))


def _image(size: int) -> bytes:
    noise = np.random.default_rng(1).integers(0, 256, size, np.uint8)
    message = STORE.types[IMAGE](_header("camera"), "jpeg", noise)
    return bytes(STORE.serialize_cdr(message, IMAGE))
