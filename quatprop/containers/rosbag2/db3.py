"""ROS 2 bags in SQLite (``.db3``), of every version of its tables."""

from __future__ import annotations

from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING, Any

import apsw
from rosbags.typesys.msg import normalize_msgtype

from quatprop.containers.base import Channel, MessageBlock, MessageLog
from quatprop.containers.compressed_messages import decompressed, is_compressed
from quatprop.containers.file_source import FileSource
from quatprop.containers.rosbag2.fetches import BLOCK_BYTES, ROWS, combined, fetch_of, next_group
from quatprop.containers.rosbag2.parts import custom_data
from quatprop.containers.rosbag2.sqlite_files import files_beside, open_database, read_wal
from quatprop.containers.rosbag2.sqlite_pages import open_pages
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.provenance import of_all_topics
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from apsw import SQLiteValue

    from quatprop.containers.msg_files import MsgFiles
    from quatprop.containers.rosbag2.fetches import Fetch


_OTHER_TYPES = "their log times or contents are of other types"


class Db3Log(MessageLog):
    """A ROS 2 bag in an SQLite database.

    Parameters
    ----------
    path
        The database.
    message_compression
        ``"zstd"`` if each message is compressed by itself; in CDR that is recognised.

    Raises
    ------
    DamagedLogError
        It is no database, or its tables of topics cannot be read.
    UnsupportedLogError
        It is another database, or its compression is not supported.
    """

    kind = "db3"

    def __init__(self, path: Path, message_compression: str | None = None) -> None:
        if message_compression not in (None, "zstd"):
            raise UnsupportedLogError(
                path,
                f"its messages are compressed with {quoted(message_compression)} and only zstd is "
                "read; decompress it with `ros2 bag convert`",
            )
        super().__init__(path)
        self._is_zstd = message_compression is not None
        self._damage: str | None = None
        self._invalid: dict[SQLiteValue, int] | None = None
        try:
            self._database = self._connect()
            try:
                self._topics = self._read_topics()
            except BaseException:
                self._database.close()
                raise
        except (apsw.Error, UnicodeDecodeError) as error:
            raise DamagedLogError(
                path, f"its database cannot be read ({error}); try `sqlite3 FILE .recover`"
            ) from error

    def _connect(self) -> apsw.Connection:
        """Open the database, read-only, with the journal files beside it."""
        beside = files_beside(self.path)
        if beside:
            try:
                database = open_database(self.path, beside)
                database.execute("SELECT count(*) FROM sqlite_master").fetchall()
            except apsw.Error as error:
                reason = f"it cannot be applied ({error}); the last messages may be missing"
                self.losses.note(beside[0], reason)
            else:
                self._note_unfinished(beside)
                return database
        return open_database(self.path)

    def _note_unfinished(self, beside: list[str]) -> None:
        """Note the end of a write-ahead log that SQLite does not apply."""
        if beside[0].endswith("-wal"):
            with FileSource(self.path.with_name(beside[0])) as wal:
                pages = read_wal(wal).unfinished
            if pages:
                reason = f"{pages} pages of a transaction that was not finished are not read"
                self.losses.note(beside[0], reason)

    def _columns(self, table: str) -> dict[str, None]:
        """Return the names of the columns of a table, in order."""
        rows = self._database.execute("SELECT name FROM pragma_table_info(?)", (table,))
        return {str(name): None for (name,) in rows}

    def _read_topics(self) -> dict[SQLiteValue, Channel]:
        """Return the channel of each topic id."""
        if not (
            self._columns("topics").keys() >= {"id", "name", "type", "serialization_format"}
            and self._columns("messages").keys() >= {"topic_id", "timestamp", "data"}
        ):
            raise UnsupportedLogError(
                self.path,
                "it is an SQLite database without the tables of a ROS 2 bag; "
                "name a database that `ros2 bag` recorded",
            )
        definitions = self._definitions()
        # As blobs, since text that is not UTF-8 is an error otherwise.
        rows = self._database.execute(
            "SELECT id, CAST(name AS BLOB), CAST(type AS BLOB), CAST(serialization_format AS BLOB)"
            "FROM topics WHERE id IS NOT NULL AND name IS NOT NULL AND type IS NOT NULL"
        )
        channels = {}
        for id_, *values in rows:
            name, type_name, encoding = (bytes(v or b"").decode(errors="replace") for v in values)
            type_name = normalize_msgtype(type_name)
            schema_encoding, schema = definitions.get(type_name, ("", b""))
            channels[id_] = Channel(name, type_name, encoding, schema_encoding, schema)
        return channels

    def _definitions(self) -> dict[str, tuple[str, bytes]]:
        """Return language and text of the definition of each type."""
        wanted = {"topic_type", "encoding", "encoded_message_definition"}
        if not self._columns("message_definitions").keys() >= wanted:
            return {}
        rows = self._database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        return {
            normalize_msgtype(str(type_name)): (str(encoding), str(definition).encode())
            for type_name, encoding, definition in rows
            if encoding in ("ros2msg", "ros2idl") and definition
        }

    def channels(self) -> list[Channel]:
        """Return every channel, in order of topic; how many messages it has is not known."""
        return sorted(
            set(self._topics.values()), key=lambda channel: (channel.topic, channel.type_name)
        )

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, in order of their log times."""
        fetches = self._fetches(channel)
        damaged = 0
        while group := next_group(fetches):
            block = combined(group)
            if self._is_zstd or (channel.encoding == "cdr" and is_compressed(block)):
                block, lost = decompressed(block)
                damaged += lost
            if len(block):
                yield block
        if damaged:
            self._lose(channel, "their zstd data is damaged", damaged)

    def _fetches(self, channel: Channel) -> Iterator[Fetch]:
        """Fetch messages in time order, and read the pages themselves where SQLite cannot."""
        self._check()
        ids = [id_ for id_, described in self._topics.items() if described == channel]
        count = 0
        if self._damage is None:
            try:
                for fetch in self._queried(ids):
                    count += len(fetch.times)
                    yield fetch
            except apsw.Error as error:
                self._damage = str(error)
        if self._damage is not None:
            yield from self._recovered(channel, ids, count)
        lost = sum((self._invalid or {}).get(id_, 0) for id_ in ids)
        if lost:
            self._lose(channel, _OTHER_TYPES, lost)

    def _check(self) -> None:
        """Count rows that are no messages, and find out whether the index lists all rows."""
        if self._invalid is not None:
            return
        self._invalid = {}
        marks = ", ".join("?" * len(self._topics))
        # Columns of SQLite hold values of any type.
        query = (
            "SELECT CASE typeof(topic_id) WHEN 'integer' THEN topic_id "  # noqa: S608  # only marks
            "WHEN 'null' THEN NULL ELSE quote(CAST(topic_id AS BLOB)) END AS key_, count(*), "
            f"topic_id IN ({marks}) AS known_ FROM messages NOT INDEXED WHERE known_ IS NOT 1 OR "
            "typeof(timestamp) <> 'integer' OR typeof(data) <> 'blob' GROUP BY key_, known_"
        )
        try:
            total = self._count("NOT INDEXED")
            for id_, count, is_known in self._database.execute(query, list(self._topics)):
                if is_known and id_ in self._topics:
                    self._invalid[id_] = count
                else:
                    reason = _OTHER_TYPES if is_known else "no topic has this id"
                    self.losses.note(f"topic id {id_}", reason, count)
            indexes = self._database.execute(
                "SELECT name FROM pragma_index_list('messages') WHERE partial = 0"
            ).fetchall()
            for (name,) in indexes:
                quoted_name = str(name).replace('"', '""')
                if self._count(f'INDEXED BY "{quoted_name}"') != total:
                    self._damage = f"its index {quoted(name)} does not list all messages"
        except apsw.Error as error:
            self._damage = str(error)

    def _count(self, how: str) -> int:
        rows = self._database.execute(f"SELECT count(*) FROM messages {how}")  # noqa: S608
        return int(str(next(rows)[0]))

    def _queried(self, ids: list[SQLiteValue]) -> Iterator[Fetch]:
        """Fetch messages with a query.

        Raises
        ------
        apsw.Error
            The database is damaged there.
        """
        marks = ", ".join("?" * len(ids))
        key = "rowid" if self._has_rowid() else "timestamp"
        # Bags have an index of the times: this order costs a tenth more than none, and no memory.
        query = (
            "SELECT timestamp, data FROM messages "  # noqa: S608  # only question marks go in
            f"WHERE topic_id IN ({marks}) AND typeof(timestamp) = 'integer' "
            f"AND typeof(data) = 'blob' ORDER BY timestamp, {key}"
        )
        cursor = self._database.execute(query, ids)
        rows = 64
        damage = None
        while damage is None:
            fetched: list[Any] = []
            try:
                # What comes before an error stays in the list.
                fetched.extend(islice(cursor, rows))
            except apsw.Error as error:
                damage = error
            if not fetched:
                break
            fetch = fetch_of(*zip(*fetched, strict=True))
            yield fetch
            rows = min(ROWS, max(1, BLOCK_BYTES * len(fetched) // (len(fetch.data) + 1)))
        if damage is not None:
            raise damage

    def _has_rowid(self) -> bool:
        with suppress(apsw.SQLError):  # WITHOUT ROWID
            self._database.execute("SELECT rowid FROM messages LIMIT 0").fetchall()
            return True
        return False

    def _recovered(self, channel: Channel, ids: list[SQLiteValue], done: int) -> Iterator[Fetch]:
        """Fetch messages after the first `done` from the pages of the file, in time order."""
        names = list(self._columns("messages"))
        topic, time, data = (names.index(name) for name in ("topic_id", "timestamp", "data"))
        with open_pages(self.path, (topic, time, data)) as pages:
            cells = sorted({cell[:3]: cell for cell in pages.cells(self._topics)}.values())
            lost = 0
            if cells:
                rowids = [cell.rowid for cell in cells]
                lost = max(rowids) - min(0, min(rowids) - 1) - len(cells)
            mine = [cell for cell in cells if cell.group in ids][done:]
            for first in range(0, len(mine), ROWS):
                group = [(c.log_ns, pages.blob(c)) for c in mine[first : first + ROWS]]
                whole = [row for row in group if row[1] is not None]
                lost += len(group) - len(whole)
                if whole:
                    yield fetch_of(*zip(*whole, strict=True))
        reason = f"its database is damaged ({self._damage}); what intact pages hold is read"
        if lost > 0:
            reason += f", and {lost} messages of any topic between them are missing"
        self._lose(channel, reason)

    def _lose(self, channel: Channel, reason: str, messages: int | None = None) -> None:
        self.losses.note(f"topic {quoted(channel.topic)}", reason, messages)

    def complete(self, files: MsgFiles) -> None:
        """Add definitions that channels lack."""
        self._topics = {id_: files.completed(channel) for id_, channel in self._topics.items()}

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic, which the metadata may carry, as JSON."""
        try:
            rows = self._database.execute("SELECT metadata FROM metadata ORDER BY rowid DESC")
            (text,) = next(rows, ("",))
        except apsw.Error:
            # Older bags have no such table.
            text = ""
        custom = custom_data(text) if isinstance(text, str) else {}
        return of_all_topics(custom)

    def close(self) -> None:
        """Close the database."""
        self._database.close()
