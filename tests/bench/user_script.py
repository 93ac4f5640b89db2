"""The script that a user writes today: rosbags for messages, a scipy Rotation a step.

Usage: user_script.py LOG OUT.csv
"""

import sys
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

stamps, rows = [], []
attitude, rate, previous = Rotation.identity(), np.zeros(3), None
with AnyReader([Path(sys.argv[1])]) as reader:
    connections = [c for c in reader.connections if c.msgtype == "sensor_msgs/msg/Imu"]
    for connection, _, raw in reader.messages(connections):
        message = reader.deserialize(raw, connection.msgtype)
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if previous is not None:
            attitude = attitude * Rotation.from_rotvec(rate * ((stamp - previous) * 1e-9))
        rate = np.array(
            [message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z]
        )
        stamps.append(stamp)
        rows.append(attitude.as_quat(scalar_first=True))
        previous = stamp
with Path(sys.argv[2]).open("w") as out:
    out.write("t_ns,qw,qx,qy,qz\n")
    for stamp, row in zip(stamps, rows, strict=True):
        out.write(f"{stamp},{row[0]!r},{row[1]!r},{row[2]!r},{row[3]!r}\n")
