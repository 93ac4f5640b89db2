"""Simulated logs in every table and container that quatprop writes.

Tables have stamps in ns and rates in rad/s as ``t_ns,wx,wy,wz``. Containers have
``sensor_msgs/Imu`` on ``/imu``: the header stamp is when the sample was taken, the log time when
it arrived, a little later.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

from quatprop.errors import OutputError, UsageError
from quatprop.simulate.imu import ImuEncoder, arrival_ns
from quatprop.text import listed, quoted
from quatprop.writers import GENERAL_KINDS, WRITERS, kind_of, open_messages, open_table
from quatprop.writers.base import SeriesWriter

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.writers.base import MessageWriter, TableWriter

RATE_COLUMNS = ("wx", "wy", "wz")

DEFAULT_COMPRESSIONS = {"rosbag2-mcap": "none"}
"""Where a recorder's default is not that of the attitude writer."""


class LogWriter(SeriesWriter):
    """Takes batches of samples in order."""

    @abstractmethod
    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:
        """Append a batch; the truth is for what depends on attitude, such as accelerations."""


class RateTable(LogWriter):
    """Rates as a table with the columns :data:`RATE_COLUMNS`."""

    def __init__(self, table: TableWriter) -> None:
        super().__init__(table)
        self._table = table

    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:  # noqa: ARG002
        """Append a batch."""
        self._table.write(measured.t_ns, list(measured.rate.T))


class ImuMessages(LogWriter):
    """Samples as messages.

    Parameters
    ----------
    container
        Takes the messages.
    encoder
        Encodes the samples.
    target
        The log, for errors.
    """

    def __init__(self, container: MessageWriter, encoder: ImuEncoder, target: Path | str) -> None:
        super().__init__(container)
        self._container = container
        self._encoder = encoder
        self._target = target

    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:
        """Append a batch."""
        messages = self._encoder.encode(measured, truth, self._target)
        self._container.write(arrival_ns(measured), messages)

    def finish(self, provenance: Mapping[str, object]) -> None:  # noqa: ARG002  # as of a recorder
        """Write the log to its end, without provenance."""
        self._container.finish({})


def open_log_writer(
    target: Path | str,
    kind: str | None = None,
    *,
    deviation: float = 0.0,
    compression: str | None = None,
) -> LogWriter:
    """Open a writer of a simulated log.

    Parameters
    ----------
    target
        Where to write; ``"-"`` is stdout.
    kind
        One of :data:`quatprop.writers.GENERAL_KINDS`; None takes it from the suffix of `target`.
    deviation
        Standard deviation of the rates' noise, rad/s, for the messages' covariance.
    compression
        ``"none"``, ``"lz4"``, ``"zstd"`` or ``"bz2"``; None is the kind's default.

    Raises
    ------
    OutputError
        The kind or suffix is unknown, or the target cannot be written.
    UsageError
        The kind has no such compression.
    """
    kind = kind_of(target, kind)
    if kind not in GENERAL_KINDS:
        raise OutputError(
            target, f"kind {quoted(kind)} holds attitudes only; choose {listed(GENERAL_KINDS)}"
        )
    compressions = WRITERS[kind].compressions
    if compression not in (None, *compressions):
        raise UsageError(
            f"a {kind} log cannot be compressed with {quoted(compression)}; "
            f"choose {listed(compressions)}"
        )
    if WRITERS[kind].columns:
        return RateTable(open_table(target, RATE_COLUMNS, kind))
    encoder = ImuEncoder(deviation, ros1="ros1" in WRITERS[kind].encodings)
    compression = compression or DEFAULT_COMPRESSIONS.get(kind)
    return ImuMessages(open_messages(target, kind, encoder.topic, compression), encoder, target)
