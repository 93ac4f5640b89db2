"""Simulated ROS 1 bags."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosbags.rosbag1 import Writer

from quatprop.simulate.imu import TOPIC, ros1_messages
from quatprop.simulate.logs import LogWriter
from quatprop.simulate.ros import IMU, arrival_ns, ros1_types
from quatprop.writers.atomic import Replacement, reported

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.series import AttitudeSeries, GyroSeries


class Rosbag1Log(LogWriter):
    """Write a ROS 1 bag.

    Parameters
    ----------
    target
        A path.
    deviation
        Standard deviation of the rates' noise, rad/s.
    compression
        Of the chunks: ``"none"``, ``"lz4"`` or ``"bz2"``.
    """

    def __init__(self, target: Path | str, deviation: float, compression: str) -> None:
        self._deviation = deviation
        self._written = 0
        self._replacement = Replacement(target)
        self._bag = Writer(self._replacement.path)
        if compression != "none":
            self._bag.set_compression(Writer.CompressionFormat[compression.upper()])
        with reported(target):
            self._bag.open()
            self._connection = self._bag.add_connection(TOPIC, IMU, typestore=ros1_types())

    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:
        """Append a batch."""
        times = arrival_ns(measured).tolist()
        messages = ros1_messages(measured, truth, self._deviation, self._written)
        with reported(self._replacement.target):
            for log_ns, data in zip(times, messages, strict=True):
                self._bag.write(self._connection, log_ns, data)
        self._written += len(measured)

    def commit(self, provenance: Mapping[str, Any]) -> None:  # noqa: ARG002  # no room for it
        """Finish the file and put it in its place."""
        with reported(self._replacement.target):
            self._bag.close()
        self._replacement.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._bag.abort()
        self._replacement.discard()
