"""ROS 2 bag folders by the block: SQLite or MCAP storage, with the library's metadata.yaml."""

from __future__ import annotations

import sqlite3
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Protocol, cast

from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from quatprop.errors import OutputError
from quatprop.writers.atomic import Replacement, reported
from quatprop.writers.mcap.file import McapFile

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import Any

    import numpy as np
    from numpy.typing import NDArray
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

    from quatprop.writers.mcap.channel import MessageChannel

    Int64 = NDArray[np.int64]

_VERSION_OFFSET = 96
_VERSION = (3_040_000).to_bytes(4, "big")


class _Storage(Protocol):
    """What both storages do beyond the library's protocol."""

    def write_block(self, connection: Connection, log_ns: Int64, messages: NDArray[Any]) -> None:
        """Append messages."""


class SteadySqlite(Sqlite3Writer):
    """The library's SQLite storage, without what differs between builds of SQLite.

    Builds differ in whether they clear the unused parts of a page: they shall, and the file is
    rewritten once to be rid of what is left. On closing, the library lets SQLite optimise,
    whereupon newer versions add tables of statistics: left out. And the header notes which
    version wrote last, which nothing reads but people: a fixed number.
    """

    def write_block(self, connection: Connection, log_ns: Int64, messages: NDArray[Any]) -> None:
        """Append messages."""
        rows = messages.view(f"V{messages.itemsize}").tolist()
        self.conn.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES(?, ?, ?)",
            zip([connection.id] * len(rows), log_ns.tolist(), rows, strict=True),
        )

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


class BulkMcap:
    """MCAP storage in place of the library's.

    Parameters
    ----------
    path
        The folder.
    compression
        ``STORAGE`` means chunks in zstd.
    """

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        self.path = path / f"{path.name}.mcap"
        self._stream = self.path.open("xb")
        self._file = McapFile(
            self._stream, "ros2", "zstd" if compression == CompressionMode.STORAGE else "none"
        )
        self._schemas: dict[str, int] = {}
        self._channels: dict[int, MessageChannel] = {}

    def add_msgtype(self, connection: Connection) -> None:
        """Declare a type of messages."""
        self._schemas[connection.msgtype] = self._file.add_schema(
            connection.msgtype, "ros2msg", connection.msgdef.data.encode()
        )

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Declare a topic."""
        self._channels[connection.id] = self._file.add_channel(
            connection.topic,
            "cdr",
            self._schemas[connection.msgtype],
            {"offered_qos_profiles": offered_qos_profiles},
        )

    def write_block(self, connection: Connection, log_ns: Int64, messages: NDArray[Any]) -> None:
        """Append messages."""
        self._channels[connection.id].write(log_ns, messages)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Messages come in blocks only."""
        raise NotImplementedError

    def close(self, version: int, metadata: str) -> None:  # noqa: ARG002  # of the protocol
        """Finish the file."""
        self._file.add_metadata("rosbag2", {"serialized_metadata": metadata})
        self._file.finish()
        self._stream.close()

    def abort(self) -> None:
        """Close the file as it is."""
        self._file.abort()
        self._stream.close()


class BulkWriter(Writer):
    """The library's writer of bag folders, over storages that take blocks."""

    STORAGE_PLUGINS = {  # noqa: RUF012  # declared by the library
        StoragePlugin.SQLITE3: SteadySqlite,
        StoragePlugin.MCAP: BulkMcap,
    }

    def write_block(self, connection: Connection, log_ns: Int64, messages: NDArray[Any]) -> None:
        """Append messages that all have one size."""
        if len(log_ns):
            cast("_Storage", self.storage).write_block(connection, log_ns, messages)
            self.counts[connection.id] += len(log_ns)
            self.min_timestamp = min(self.min_timestamp, int(log_ns.min()))
            self.max_timestamp = max(self.max_timestamp, int(log_ns.max()))


class BagFolder:
    """A ROS 2 bag of one topic being written, to be committed or to vanish.

    Parameters
    ----------
    target
        A path where nothing is yet.
    storage
        How the messages are stored.
    compression
        ``STORAGE`` compresses the chunks of an MCAP file.
    topic, kind, types
        What is published where.
    """

    def __init__(  # noqa: PLR0913  # a bag, told in full
        self,
        target: Path | str,
        storage: StoragePlugin,
        compression: CompressionMode,
        *,
        topic: str,
        kind: str,
        types: Typestore,
    ) -> None:
        self._target = target
        self._replacement = Replacement(target, folder=True)
        self._bag = BulkWriter(self._replacement.path, version=9, storage_plugin=storage)
        self._bag.compression_mode = compression
        with _reported(target):
            self._bag.open()
            self._connection = self._bag.add_connection(topic, kind, typestore=types)

    def write(self, log_ns: Int64, messages: NDArray[Any]) -> None:
        """Append messages that all have one size, and when each was logged, ns."""
        with _reported(self._target):
            self._bag.write_block(self._connection, log_ns, messages)

    def commit(self, provenance: str = "") -> None:
        """Finish the folder, with words on its provenance, and put it in its place."""
        if provenance:
            self._bag.set_custom_data("quatprop", provenance)
        with _reported(self._target):
            self._bag.close()
        self._replacement.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        with suppress(OSError, sqlite3.Error):
            self._bag.abort()
        self._replacement.discard()


@contextmanager
def _reported(target: Path | str) -> Iterator[None]:
    """Turn errors of the system and of SQLite into an error that names the target."""
    with reported(target):
        try:
            yield
        except sqlite3.Error as error:
            raise OutputError(target, f"cannot be written: {error}") from error
