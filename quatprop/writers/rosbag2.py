"""ROS 2 bag folders of one topic, with SQLite or MCAP storage.

The rosbags library writes the tables and metadata.yaml; messages are stored a block at a time. The
provenance is in the custom data of metadata.yaml, under the key ``quatprop``, as JSON.
"""

from __future__ import annotations

import sqlite3
from contextlib import suppress
from typing import TYPE_CHECKING, cast

from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from quatprop.writers.atomic import OutputPath
from quatprop.writers.base import MessageWriter, provenance_json
from quatprop.writers.mcap import McapFile
from quatprop.writers.message_encoders import Topic

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from rosbags.interfaces import Connection

    from quatprop.base.arrays import AnyArray, Int64, Records


_COMPRESSIONS = {"none": CompressionMode.NONE, "zstd": CompressionMode.STORAGE}

_VERSION_OFFSET = 96
_VERSION = (3_040_000).to_bytes(4, "big")


class ReproducibleSqlite(Sqlite3Writer):
    """The library's SQLite storage, with the same bytes from all builds of SQLite.

    Some builds do not clear the unused parts of pages: here they are cleared, and the file is
    rewritten once. On closing, the library lets SQLite optimise, which adds tables of statistics in
    newer versions: omitted here. The header states the version that wrote last, which no program
    reads: a fixed number here. As for other outputs there is no fsync: SQLite would wait for the
    disk sixteen times.
    """

    SQLITE_SCHEMA = f"PRAGMA synchronous = OFF;{Sqlite3Writer.SQLITE_SCHEMA}"

    def write_block(self, connection: Connection, log_ns: Int64, messages: AnyArray) -> None:
        """Append messages, all of one size, with their log times, ns."""
        rows = messages.view(f"V{messages.itemsize}").tolist()
        self.conn.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
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
    """An MCAP storage that replaces the library's.

    `compression`: ``STORAGE`` means chunks compressed with zstd
    """

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        self.path = path / f"{path.name}.mcap"
        self._stream = self.path.open("xb")
        self._file = McapFile(
            self._stream, "ros2", "zstd" if compression == CompressionMode.STORAGE else "none"
        )

    def add_msgtype(self, connection: Connection) -> None:
        """Do nothing: types are declared with their topics."""

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Declare a topic."""
        schema = connection.msgdef.data.encode()
        topic = Topic(connection.topic, connection.msgtype, "cdr", "ros2msg", schema)
        self._file.declare_channel(topic, {"offered_qos_profiles": offered_qos_profiles})

    def write_block(self, _connection: Connection, log_ns: Int64, messages: Records) -> None:
        """Append messages."""
        self._file.write(log_ns, messages)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Refuse single messages: only blocks are written."""
        raise NotImplementedError

    def close(self, version: int, metadata: str) -> None:  # noqa: ARG002  # of the library's protocol
        """Finish the file."""
        self._file.add_metadata("rosbag2", {"serialized_metadata": metadata})
        self._file.finish()
        self._stream.close()

    def abort(self) -> None:
        """Close the unfinished file."""
        self._file.abort()
        self._stream.close()


class BulkWriter(Writer):
    """The library's writer of bag folders, with storages that write blocks."""

    STORAGE_PLUGINS = {  # noqa: RUF012  # declared by the library
        StoragePlugin.SQLITE3: ReproducibleSqlite,
        StoragePlugin.MCAP: BulkMcap,
    }

    def write_block(self, connection: Connection, log_ns: Int64, messages: AnyArray) -> None:
        """Append messages that all have one size."""
        if len(log_ns):
            storage = cast("ReproducibleSqlite | BulkMcap", self.storage)
            storage.write_block(connection, log_ns, messages)
            self.counts[connection.id] += len(log_ns)
            self.min_timestamp = min(self.min_timestamp, int(log_ns.min()))
            self.max_timestamp = max(self.max_timestamp, int(log_ns.max()))


class SqliteBagWriter(MessageWriter):
    """Write messages to a ROS 2 bag that stores them in SQLite.

    `compression`: compression of the chunks of an MCAP file: ``"zstd"`` or ``"none"``
    """

    _output: OutputPath
    storage = StoragePlugin.SQLITE3
    _other_errors = (sqlite3.Error,)

    def __init__(self, target: Path | str, topic: Topic, compression: str) -> None:
        super().__init__(OutputPath(target, folder=True))
        self._bag = BulkWriter(self._output.path, version=8, storage_plugin=self.storage)
        self._bag.compression_mode = _COMPRESSIONS[compression]
        with self._opening():
            self._bag.open()
            self._connection = self._bag.add_connection(
                topic.name, topic.type_name, msgdef=topic.schema.decode(), rihs01=topic.digest
            )

    def _write(self, log_ns: Int64, messages: Records) -> None:
        self._bag.write_block(self._connection, log_ns, messages)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        if provenance:
            self._bag.set_custom_data("quatprop", provenance_json(provenance))
        self._bag.close()

    def abort(self) -> None:
        """Discard uncommitted output."""
        with suppress(OSError, sqlite3.Error):
            self._bag.abort()
        super().abort()


class McapBagWriter(SqliteBagWriter):
    """Write messages to a ROS 2 bag that stores them in MCAP; parameters as above."""

    storage = StoragePlugin.MCAP
