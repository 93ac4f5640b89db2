"""Simulated ROS 2 bag folders: SQLite or MCAP, with metadata.yaml."""

from __future__ import annotations

import sqlite3
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

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

_VERSION_OFFSET = 96
_VERSION = (3_040_000).to_bytes(4, "big")


class SteadyStorage(Sqlite3Writer):
    """The library's SQLite storage, without what differs between builds of SQLite.

    Builds differ in whether they clear the unused parts of a page: they shall, and the file is
    rewritten once to be rid of what is left. On closing, the library lets SQLite optimise,
    whereupon newer versions add tables of statistics: left out. And the header notes which
    version wrote last, which nothing reads but people: a fixed number.
    """

    def close(self, version: int, metadata: str) -> None:
        """Finish the file."""
        self.cursor.execute(
            "INSERT INTO metadata(metadata_version, metadata) VALUES(?, ?)", (version, metadata)
        )
        self.conn.commit()
        self.conn.execute("PRAGMA secure_delete = ON")
        self.conn.execute("VACUUM")
        self.conn.close()
        with self.path.open("r+b") as file:
            file.seek(_VERSION_OFFSET)
            file.write(_VERSION)


class SteadyWriter(Writer):
    """The library's writer of bag folders, with a steady SQLite storage."""

    STORAGE_PLUGINS = {  # noqa: RUF012  # declared by the library
        **Writer.STORAGE_PLUGINS,
        StoragePlugin.SQLITE3: SteadyStorage,
    }


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
        self._bag = SteadyWriter(self._replacement.path, version=9, storage_plugin=self.storage)
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
        self._replacement.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        with suppress(OSError, sqlite3.Error):
            self._bag.abort()
        self._replacement.discard()


class SqliteLog(McapFolderLog):
    """Write a ROS 2 bag folder that stores its messages in SQLite; parameters as above."""

    storage = StoragePlugin.SQLITE3


@contextmanager
def _reported(target: Path | str) -> Iterator[None]:
    """Turn errors of the system and of SQLite into an error that names the target."""
    with reported(target):
        try:
            yield
        except sqlite3.Error as error:
            raise OutputError(target, f"cannot be written: {error}") from error
