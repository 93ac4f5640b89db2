"""Simulated ROS 1 bags."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.simulate.imu import TOPIC, ros1_messages
from quatprop.simulate.logs import LogWriter
from quatprop.simulate.ros import IMU, arrival_ns
from quatprop.writers.atomic import Output, refuse_streams, reported
from quatprop.writers.messages.ros_types import ros1_types
from quatprop.writers.rosbag1.file import BagFile

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
        definition, md5sum = ros1_types().generate_msgdef(IMU)
        refuse_streams(target, "a ROS 1 bag")
        self._output = Output(target)
        with reported(target):
            self._bag = BagFile(
                self._output.stream,
                compression,
                topic=TOPIC,
                kind=IMU.replace("/msg/", "/"),
                definition=definition,
                md5sum=md5sum,
            )

    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:
        """Append a batch."""
        messages = ros1_messages(measured, truth, self._deviation, self._written)
        with reported(self._output.target):
            self._bag.write(arrival_ns(measured), messages)
        self._written += len(measured)

    def commit(self, provenance: Mapping[str, Any]) -> None:  # noqa: ARG002  # no room for it
        """Finish the file and put it in its place."""
        with reported(self._output.target):
            self._bag.finish()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._bag.abort()
        self._output.discard()
