"""Simulated ROS 2 bag folders: SQLite or MCAP, with metadata.yaml."""

from __future__ import annotations

import sqlite3
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from quatprop.errors import OutputError
from quatprop.simulate.imu import TOPIC, cdr_messages
from quatprop.simulate.logs import LogWriter
from quatprop.simulate.ros import IMU, arrival_ns, ros2_types
from quatprop.writers.atomic import Replacement, reported

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.series import AttitudeSeries, GyroSeries

_SQLITE_VERSION_OFFSET = 96
_SQLITE_VERSION = (3_040_000).to_bytes(4, "big")


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
        self._target = target
        self._deviation = deviation
        self._replacement = Replacement(target, folder=True)
        self._bag = Writer(self._replacement.path, version=9, storage_plugin=self.storage)
        if compression != "none":
            self._bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with _reported(target):
            self._bag.open()
            self._connection = self._bag.add_connection(TOPIC, IMU, typestore=ros2_types())

    def write(self, measured: GyroSeries, truth: AttitudeSeries) -> None:
        """Append a batch."""
        times = arrival_ns(measured).tolist()
        messages = cdr_messages(measured, truth, self._deviation)
        with _reported(self._target):
            for log_ns, data in zip(times, messages, strict=True):
                self._bag.write(self._connection, log_ns, data)

    def commit(self, provenance: Mapping[str, Any]) -> None:  # noqa: ARG002  # no room for it
        """Finish the folder and put it in its place."""
        with _reported(self._target):
            self._bag.close()
            self._settle()
        self._replacement.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        with suppress(OSError, sqlite3.Error):
            self._bag.abort()
        self._replacement.discard()

    def _settle(self) -> None:
        """Remove what differs between machines from the finished file."""


class SqliteLog(McapFolderLog):
    """Write a ROS 2 bag folder that stores its messages in SQLite; parameters as above."""

    storage = StoragePlugin.SQLITE3

    def _settle(self) -> None:
        """Write a fixed number where SQLite notes which of its versions wrote last.

        Nothing reads it but people; without this the same recording would differ in four bytes
        between one Python and the next.
        """
        path = self._replacement.path
        with (path / f"{path.name}.db3").open("r+b") as file:
            file.seek(_SQLITE_VERSION_OFFSET)
            file.write(_SQLITE_VERSION)


@contextmanager
def _reported(target: Path | str) -> Iterator[None]:
    """Turn errors of the system and of SQLite into an error that names the target."""
    with reported(target):
        try:
            yield
        except sqlite3.Error as error:
            raise OutputError(target, f"cannot be written: {error}") from error
