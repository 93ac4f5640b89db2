"""Intact logs of messages that are not of ROS: ULog, and JSON and protobuf in MCAP."""

import json
import struct

import numpy as np
from make.json_messages import imu
from make.protobuf import FOXGLOVE, described, made, stamp_file
from make.ulog import added, gyro, record
from make.ulog import write as write_ulog
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from quatprop.containers.ulog_records import SYNC


def write_message_logs(folder, samples):
    """Write a log of each kind into a folder."""
    k = np.arange(samples)
    rates = np.sin(k[:, None] / 10 + np.arange(3)).tolist()
    _write_mcap(folder / "json.mcap", "sensor_msgs/Imu", ("json", "jsonschema", b"{}"), [
        json.dumps(imu(*rate, stamp={"sec": i // 100, "nanosec": i % 100 * 10_000_000})).encode()
        for i, rate in enumerate(rates)
    ])  # fmt: skip
    odometry = made("foxglove.Odometry", FOXGLOVE, stamp_file())
    messages = []
    for i, (x, y, z) in enumerate(rates):
        message = odometry(frame_id="odom", body_frame_id="base")
        message.timestamp.seconds, message.timestamp.nanos = divmod(10_000_000 * i, 10**9)
        message.angular_velocity.x, message.angular_velocity.y = x, y
        message.angular_velocity.z = z
        messages.append(message.SerializeToString())
    schema = described(FOXGLOVE, stamp_file())
    _write_mcap(
        folder / "protobuf.mcap", "foxglove.Odometry", ("protobuf", "protobuf", schema), messages
    )
    between = [record(b"S", SYNC), record(b"L", b"6" + bytes(8) + b"hello"),
               record(b"D", struct.pack("<HQf", 7, 3, 1.0))]  # fmt: skip
    baro = record(b"F", b"sensor_baro:uint64_t timestamp;float pressure;")
    records = [baro, added("sensor_gyro", 0, 1), added("sensor_baro", 0, 7)]
    for i, message in enumerate(gyro(1, (10_000 * (k + 1)).tolist(), 1e-3)):
        records += [message, between[i % len(between)]]
    write_ulog(folder / "gyro.ulg", *records)


def _write_mcap(path, type_name, how, messages):
    encoding, schema_encoding, schema = how
    with path.open("wb") as stream:
        writer = McapWriter(
            stream, chunk_size=20_000, enable_crcs=False, compression=CompressionType.NONE
        )
        writer.start()
        id_ = writer.register_schema(type_name, schema_encoding, schema)
        channel = writer.register_channel("/imu", encoding, id_)
        for i, message in enumerate(messages):
            writer.add_message(channel, 10_000_000 * i, message, 10_000_000 * i)
        writer.finish()
