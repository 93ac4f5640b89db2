"""Simulated ROS 2 bag folders: SQLite or MCAP, with metadata.yaml."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosbags.rosbag2 import CompressionMode, StoragePlugin

from quatprop.simulate.imu import TOPIC, cdr_messages
from quatprop.simulate.logs import LogWriter
from quatprop.simulate.ros import IMU, arrival_ns
from quatprop.writers.messages.ros_types import ros2_types
from quatprop.writers.rosbag2.folder import BagFolder

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.series import AttitudeSeries, GyroSeries

_COMPRESSIONS = {"none": CompressionMode.NONE, "zstd": CompressionMode.STORAGE}


class McapFolderLog(LogWriter):
    """Write a ROS 2 bag folder that stores its messages in MCAP.

    Parameters
    ----------
    target
        A path where nothing is yet.
    deviation
        Standard deviation of the rates' noise, rad/s.
    compression
        Of the chunks: ``"zstd"`` or ``"none"``.
    """

    storage = StoragePlugin.MCAP

    def __init__(self, target: Path | str, deviation: float, compression: str) -> None:
        self._deviation = deviation
        self._bag = BagFolder(
            target,
            self.storage,
            _COMPRESSIONS[compression],
            topic=TOPIC,
            kind=IMU,
            types=ros2_types(),
        )

    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:
        """Append a batch."""
        messages = cdr_messages(measured, truth, self._deviation)
        self._bag.write(arrival_ns(measured), messages)

    def commit(self, provenance: Mapping[str, Any]) -> None:  # noqa: ARG002  # the truth has it
        """Finish the folder and put it in its place."""
        self._bag.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._bag.abort()


class SqliteLog(McapFolderLog):
    """Write a ROS 2 bag folder that stores its messages in SQLite; parameters as above."""

    storage = StoragePlugin.SQLITE3
