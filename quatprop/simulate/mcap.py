"""Simulated MCAP files: profile ros2, CDR messages, the definition embedded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.simulate.imu import TOPIC, cdr_messages
from quatprop.simulate.logs import LogWriter
from quatprop.simulate.ros import IMU, arrival_ns
from quatprop.writers.atomic import Output, reported
from quatprop.writers.mcap.file import McapFile
from quatprop.writers.messages.ros_types import ros2_types

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.series import AttitudeSeries, GyroSeries


class McapLog(LogWriter):
    """Write an MCAP file.

    Parameters
    ----------
    target
        A path.
    deviation
        Standard deviation of the rates' noise, rad/s.
    compression
        Of the chunks: ``"zstd"``, ``"lz4"`` or ``"none"``.
    """

    def __init__(self, target: Path | str, deviation: float, compression: str) -> None:
        self._deviation = deviation
        self._output = Output(target)
        definition, _ = ros2_types().generate_msgdef(IMU, ros_version=2)
        with reported(target):
            self._mcap = McapFile(self._output.stream, "ros2", compression)
            schema = self._mcap.add_schema(IMU, "ros2msg", definition.encode())
            self._channel = self._mcap.add_channel(TOPIC, "cdr", schema)

    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:
        """Append a batch."""
        messages = cdr_messages(measured, truth, self._deviation)
        with reported(self._output.target):
            self._channel.write(arrival_ns(measured), messages)

    def commit(self, provenance: Mapping[str, Any]) -> None:  # noqa: ARG002  # no room for it
        """Finish the file and put it in its place."""
        with reported(self._output.target):
            self._mcap.finish()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._mcap.abort()
        self._output.discard()
