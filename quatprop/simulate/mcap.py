"""Simulated MCAP files: profile ros2, CDR messages, the definition embedded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mcap.writer import CompressionType, Writer

from quatprop.simulate.imu import TOPIC, cdr_messages
from quatprop.simulate.logs import LogWriter
from quatprop.simulate.ros import IMU, arrival_ns, ros2_types
from quatprop.writers.atomic import Output, reported

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
        self._written = 0
        self._output = Output(target)
        self._mcap = Writer(self._output.stream, compression=CompressionType[compression.upper()])
        definition, _ = ros2_types().generate_msgdef(IMU, ros_version=2)
        with reported(target):
            self._mcap.start(profile="ros2", library="quatprop")
            schema = self._mcap.register_schema(IMU, "ros2msg", definition.encode())
            self._channel = self._mcap.register_channel(TOPIC, "cdr", schema)

    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:
        """Append a batch."""
        times = arrival_ns(measured).tolist()
        messages = cdr_messages(measured, truth, self._deviation)
        with reported(self._output.target):
            for log_ns, data in zip(times, messages, strict=True):
                self._mcap.add_message(self._channel, log_ns, data, log_ns, self._written)
                self._written += 1

    def commit(self, provenance: Mapping[str, Any]) -> None:  # noqa: ARG002  # no room for it
        """Finish the file and put it in its place."""
        with reported(self._output.target):
            self._mcap.finish()  # type: ignore[no-untyped-call]
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._output.discard()
