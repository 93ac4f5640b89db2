"""Simulated recordings in every container that quatprop reads.

Tables carry stamps in ns and rates in rad/s as ``t_ns,wx,wy,wz``. Message logs carry
``sensor_msgs/Imu`` on ``/imu``: the header stamp is when the sample was taken, the log time when
it arrived, a little later.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.errors import OutputError, UsageError
from quatprop.text import listed, quoted
from quatprop.writers.base import Uncommitted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.writers.base import Table

RATE_COLUMNS = ("wx", "wy", "wz")


class LogWriter(Uncommitted):
    """Takes batches of samples in order."""

    @abstractmethod
    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:
        """Append a batch; the truth is for what depends on attitude, such as accelerations."""


class TableLog(LogWriter):
    """Rates as a table.

    Parameters
    ----------
    table
        A table with the columns :data:`RATE_COLUMNS`.
    """

    def __init__(self, table: Table) -> None:
        self._table = table

    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:  # noqa: ARG002
        """Append a batch."""
        self._table.write(measured.t_ns, list(measured.rate.T))

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the file and put it in its place."""
        self._table.commit(provenance)

    def abort(self) -> None:
        """Remove what was not committed."""
        self._table.abort()


@dataclass(frozen=True, slots=True)
class LogFormat:
    """One line of :data:`LOGS`.

    Parameters
    ----------
    suffixes
        File name endings that mean this format.
    opener
        ``module:name`` of what writes it, imported when it is needed: of a target for a table, of
        a target, the noise's deviation and the compression for a message log.
    compressions
        What it can be compressed with; the first is the default.
    table
        Whether the opener gives a table.
    """

    suffixes: tuple[str, ...]
    opener: str
    compressions: tuple[str, ...] = ("none",)
    table: bool = False


LOGS: Mapping[str, LogFormat] = {
    "csv": LogFormat((".csv",), "quatprop.writers.tables.csv:CsvTable", table=True),
    "parquet": LogFormat(
        (".parquet", ".pq"), "quatprop.writers.tables.parquet:ParquetTable", ("zstd",), table=True
    ),
    "mcap": LogFormat((".mcap",), "quatprop.simulate.mcap:McapLog", ("zstd", "lz4", "none")),
    "bag": LogFormat((".bag",), "quatprop.simulate.rosbag1:Rosbag1Log", ("none", "lz4", "bz2")),
    "rosbag2": LogFormat(("",), "quatprop.simulate.rosbag2:SqliteLog"),
    "rosbag2-mcap": LogFormat((), "quatprop.simulate.rosbag2:McapFolderLog", ("none", "zstd")),
}
"""Every kind of log that can be simulated; the keys are what ``--to`` accepts."""


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
        Where to write; ``"-"`` is stdout, for CSV.
    kind
        A key of :data:`LOGS`; without it, the suffix of `target` decides. No suffix means a
        ROS 2 bag folder.
    deviation
        Standard deviation of the rates' noise, rad/s, for the messages' covariance.
    compression
        ``"none"``, ``"lz4"``, ``"zstd"`` or ``"bz2"``; None is the kind's own default.

    Raises
    ------
    OutputError
        The kind or suffix is unknown, or the target cannot be written.
    UsageError
        The kind has no such compression.
    """
    kind = kind or log_kind_of(target)
    chosen = LOGS[kind]
    compression = compression or chosen.compressions[0]
    if compression not in chosen.compressions:
        raise UsageError(
            f"a {kind} log cannot be compressed with {quoted(compression)}; "
            f"choose {listed(chosen.compressions)}"
        )
    module, _, name = chosen.opener.partition(":")
    opener = getattr(import_module(module), name)
    if chosen.table:
        return TableLog(opener(target, RATE_COLUMNS))
    writer: LogWriter = opener(target, deviation, compression)
    return writer


def log_kind_of(target: Path | str) -> str:
    """Return the kind of log that a target's suffix means.

    Raises
    ------
    OutputError
        It means none.

    Examples
    --------
    >>> log_kind_of("flight.bag"), log_kind_of("flight")
    ('bag', 'rosbag2')
    """
    if str(target) == "-":
        return "csv"
    suffix = Path(target).suffix.lower()
    for kind, known in LOGS.items():
        if suffix in known.suffixes:
            return kind
    suffixes = ", ".join(s for known in LOGS.values() for s in known.suffixes if s)
    raise OutputError(
        target,
        f"the suffix does not tell the log's format; use one of {suffixes}, none for a ROS 2 bag "
        f"folder, or say --to {'|'.join(LOGS)}",
    )
