"""ROS 2 bags in SQLite (``.db3``), all versions of the tables."""

from __future__ import annotations

from array import array
from contextlib import suppress
from itertools import islice
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import apsw
import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from quatprop.base.errors import DamagedLogError, UnsupportedLogError
from quatprop.base.provenance import of_all_topics
from quatprop.base.text import plain, quoted
from quatprop.base.times import LATEST
from quatprop.readers.containers.message_log import MessageLog
from quatprop.readers.containers.parts import decompressed
from quatprop.readers.containers.rosbag2_parts import custom_data
from quatprop.readers.containers.sqlite import (
    journal_files,
    limit_steps,
    note_joined_bytes,
    open_database,
    rows_past_damage,
    unfinished_pages,
)
from quatprop.readers.messages.blocks import Channel, MessageBlock, by_topic
from quatprop.readers.tables.model import TimeRange
from quatprop.stores.file_source import FileSource

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from apsw import SQLiteValue
    from numpy.typing import NDArray

    from quatprop.readers.containers.sqlite import Row


# The tables of a ROS 2 bag in SQLite: topics, and a check of the indexes.


_LEAST_ROW = 24
"""Bytes that a message takes in a database."""


def columns_of(database: apsw.Connection, table: str) -> dict[str, None]:
    """Return the names of the columns of a table, in order."""
    rows = database.execute("SELECT name FROM pragma_table_info(?)", (table,))
    return {str(name): None for (name,) in rows}


_TABLES = frozenset({"topics", "messages", "message_definitions", "metadata"})
"""The tables that are read."""


def refuse_computed(database: apsw.Connection, path: Path) -> None:
    """Refuse a database in which one of these tables is a view or a virtual table."""
    # Read as blobs: text that is not UTF-8 would be an error.
    rows = database.execute(
        "SELECT CAST(type AS BLOB), CAST(name AS BLOB), CAST(lower(tbl_name) AS BLOB), rootpage "
        "FROM sqlite_master"
    )
    for *texts, root in rows:
        kind, name, table = (bytes(text or b"").decode(errors="replace") for text in texts)
        if table in _TABLES and (kind not in {"table", "index"} or not root):
            kind = "virtual table" if kind == "table" else kind
            raise UnsupportedLogError(
                path,
                f"its {quoted(name)} is a {plain(kind)}, and only tables that hold their rows are "
                "read; name a database that `ros2 bag` recorded",
            )


def read_topics(database: apsw.Connection, path: Path) -> dict[SQLiteValue, Channel]:
    """Return the channel of each topic id."""
    refuse_computed(database, path)
    if not (
        columns_of(database, "topics").keys() >= {"id", "name", "type", "serialization_format"}
        and columns_of(database, "messages").keys() >= {"topic_id", "timestamp", "data"}
    ):
        raise UnsupportedLogError(
            path,
            "it is an SQLite database without the tables of a ROS 2 bag; "
            "name a database that `ros2 bag` recorded",
        )
    definitions = _definitions(database)
    # Read as blobs: text that is not UTF-8 would be an error.
    rows = database.execute(
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


def _definitions(database: apsw.Connection) -> dict[str, tuple[str, bytes]]:
    """Return the language and text of each type's definition."""
    wanted = {"topic_type", "encoding", "encoded_message_definition"}
    if not columns_of(database, "message_definitions").keys() >= wanted:
        return {}
    rows = database.execute(
        "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    )
    return {
        normalize_msgtype(str(type_name)): (str(encoding), str(definition).encode())
        for type_name, encoding, definition in rows
        if encoding in ("ros2msg", "ros2idl") and definition
    }


def check_indexes(database: apsw.Connection) -> None:
    """Raise an error of SQLite if an index does not list each row once.

    The number of rows and the sum of their row ids are compared.
    """
    indexes = _indexes(database)
    if not indexes and database.execute("PRAGMA quick_check(1)").fetchall() != [("ok",)]:
        raise apsw.CorruptError("its pages do not account for all messages")
    what = "count(*), sum(rowid)" if has_rowid(database) else "count(*)"
    for name in indexes:
        quoted_name = name.replace('"', '""')
        rows = _numbers(database, what, f'INDEXED BY "{quoted_name}"')
        # If the row ids are consecutive, these are all rows; else the whole table is counted.
        if rows != _consecutive(database) and rows != _numbers(database, what, "NOT INDEXED"):
            raise apsw.CorruptError(f"its index {quoted(name)} does not list all messages")


def _consecutive(database: apsw.Connection) -> list[int]:
    """Return number and sum of the row ids from the first to the last; empty without row ids."""
    if not has_rowid(database):
        return []
    first, last = _numbers(database, "min(rowid), (SELECT max(rowid) FROM messages)")
    count = last - first + 1
    return [count, (first + last) * count // 2]


def _indexes(database: apsw.Connection) -> list[str]:
    """Return the names of the indexes of all rows."""
    rows = database.execute("SELECT name FROM pragma_index_list('messages') WHERE partial = 0")
    return [str(name) for (name,) in rows]


def _numbers(database: apsw.Connection, expressions: str, how: str = "") -> list[int]:
    rows = database.execute(f"SELECT {expressions} FROM messages {how}")  # noqa: S608  # no text of others
    return [int(str(value or 0)) for value in next(rows)]


def _indexed_rows(database: apsw.Connection) -> tuple[int, int]:
    """Return number of rows and first row id by an index; zeros without one."""
    for name in _indexes(database):
        quoted_name = name.replace('"', '""')
        with suppress(apsw.Error):
            count, first = _numbers(database, "count(*), min(rowid)", f'INDEXED BY "{quoted_name}"')
            return count, first
    return 0, 0


def has_rowid(database: apsw.Connection) -> bool:
    """Return whether rows have row ids."""
    with suppress(apsw.SQLError):  # WITHOUT ROWID
        database.execute("SELECT rowid FROM messages LIMIT 0").fetchall()
        return True
    return False


# Fetch the rows of a query in groups, and combine them into blocks of messages.


ROWS = 256
"""Maximum number of rows that are fetched together: they fit the processor's cache."""

FETCHES = 16
"""Number of fetches in a block: large blocks cost less to decode."""

BLOCK_BYTES = 4 << 20
"""Bytes from which a block is complete, even of fewer fetches."""


class Fetch(NamedTuple):
    """Rows that were fetched together: log times, ns, lengths and bytes of the messages."""

    times: NDArray[np.int64]
    lengths: NDArray[np.int64]
    data: bytes


def fetch_of(rows: Sequence[tuple[int | None, bytes]]) -> Fetch:
    """Return rows of log time and bytes as arrays, without rows that have no time."""
    times, messages = zip(*rows, strict=True)
    if None in times:
        timed = [row for row in rows if row[0] is not None]
        times, messages = zip(*timed, strict=True) if timed else ((), ())
    return Fetch(
        # NumPy's conversion would accept fractions.
        np.frombuffer(array("q", times), np.int64),
        np.fromiter(map(len, messages), np.int64, len(messages)),
        b"".join(messages),
    )


def fetched(cursor: Iterator[tuple[Any, ...]]) -> Iterator[tuple[int, Fetch]]:
    """Yield the rows of a query in groups: their number, and the fetch of those with a time."""
    size = 64
    damage = None
    while damage is None:
        rows: list[Any] = []
        try:
            # Rows before an error stay in the list.
            rows.extend(islice(cursor, size))
        except apsw.Error as error:
            damage = error
        if not rows:
            break
        fetch = fetch_of(rows)
        yield len(rows), fetch
        size = min(ROWS, max(1, BLOCK_BYTES * len(rows) // (len(fetch.data) + 1)))
    if damage is not None:
        raise damage


def next_group(fetches: Iterator[Fetch]) -> list[Fetch]:
    """Return the next fetches, enough for one block; empty at the end."""
    group: list[Fetch] = []
    size = 0
    for fetch in fetches:
        if len(fetch.times):
            group.append(fetch)
        size += len(fetch.data)
        if len(group) == FETCHES or size > BLOCK_BYTES:
            break
    return group


def combined(fetches: list[Fetch]) -> MessageBlock:
    """Combine fetches into one block."""
    times_of, lengths_of, data = zip(*fetches, strict=True)
    times, lengths = np.concatenate(times_of), np.concatenate(lengths_of)
    ends = np.cumsum(lengths)
    buffer = np.frombuffer(b"".join(data), np.uint8)
    return MessageBlock(buffer, ends - lengths, ends, times, times, int(times[-1]))


EVERY_TIME = TimeRange(-LATEST, LATEST)
"""All log times: with this range, rows without a valid time are counted as lost."""


class Db3Log(MessageLog):
    """A ROS 2 bag in an SQLite database.

    `is_zstd`: whether messages are compressed one by one; for CDR this is detected, too
    """

    kind = "db3"

    def __init__(self, path: Path, *, is_zstd: bool = False) -> None:
        super().__init__(path)
        self._is_zstd = is_zstd
        try:
            self._database = self._connect()
            try:
                self._topics = read_topics(self._database, path)
            except BaseException:
                self._database.close()
                raise
        except (apsw.Error, UnicodeDecodeError) as error:
            raise DamagedLogError(
                path, f"its database cannot be read ({error}); try `sqlite3 FILE .recover`"
            ) from error

    def _connect(self) -> apsw.Connection:
        """Open the database, read-only, with the journal files next to it."""
        journals = journal_files(self.path)
        if journals:
            try:
                database = open_database(self.path, journals)
                database.execute("SELECT count(*) FROM sqlite_master").fetchall()
            except apsw.Error as error:
                reason = f"it cannot be applied ({error}); the last messages may be missing"
                self.losses.note(journals[0], reason)
            else:
                self._note_unfinished(journals)
                return database
        database = open_database(self.path)
        note_joined_bytes(database, self.path, self.losses)
        return database

    def _note_unfinished(self, journals: list[str]) -> None:
        """Record the end of a write-ahead log that SQLite does not apply."""
        if journals[0].endswith("-wal"):
            with FileSource(self.path.with_name(journals[0])) as wal:
                pages = unfinished_pages(wal)
            if pages:
                reason = f"{pages} pages of a transaction that was not finished are not read"
                self.losses.note(journals[0], reason)

    def channels(self) -> list[Channel]:
        """Return all channels in order of topic; their numbers of messages are unknown."""
        return by_topic(set(self._topics.values()))

    def recorded_span(self, channel: Channel) -> TimeRange | None:  # noqa: ARG002  # of all topics
        """Return the bag's range of log times; None without an intact index of the times."""
        try:
            check_indexes(self._database)
            indexed = self._database.execute(
                "SELECT 1 FROM pragma_index_list('messages') AS one, pragma_index_info(one.name) "
                "AS part WHERE partial = 0 AND seqno = 0 AND part.name = 'timestamp'"
            ).fetchall()
            first, last = next(
                self._database.execute(
                    "SELECT (SELECT min(timestamp) FROM messages),"
                    "(SELECT max(timestamp) FROM messages)"
                )
            )
        except apsw.Error:
            return None
        if not indexed or not isinstance(first, int) or not isinstance(last, int):
            return None
        return TimeRange(first, last)

    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel in a range of log times, in order of log time."""
        fetches = self._fetches(channel, within or EVERY_TIME)
        damaged = 0
        while group := next_group(fetches):
            block, lost = decompressed(combined(group), channel.encoding, is_known=self._is_zstd)
            damaged += lost
            if len(block):
                yield block
        if damaged:
            self._lose(channel, "their zstd data is damaged", damaged)

    def _fetches(self, channel: Channel, within: TimeRange) -> Iterator[Fetch]:
        """Fetch messages in time order; if SQLite fails, those that it can reach."""
        ids = [id_ for id_, described in self._topics.items() if described == channel]
        count = 0
        limit_steps(self._database, self.path.stat().st_size)
        try:
            check_indexes(self._database)
            for fetch in self._queried(channel, ids, within):
                count += len(fetch.times)
                yield fetch
        except apsw.Error as error:
            yield from self._recovered(channel, ids, within, count, str(error))

    def _queried(
        self, channel: Channel, ids: list[SQLiteValue], within: TimeRange
    ) -> Iterator[Fetch]:
        """Fetch messages with a query, and count rows that are not messages."""
        parameters = [*ids, *(id_ for id_ in self._topics if id_ not in ids)]
        marks = [f"?{k + 1}" for k in range(len(parameters))]
        this_topic = f"topic_id IN ({', '.join(marks[: len(ids)])})"
        no_topic = f"topic_id IN ({', '.join(marks)}) IS NOT 1"
        is_message = f"{this_topic} AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
        in_range = ""
        if within != EVERY_TIME:
            in_range = f"timestamp BETWEEN {within.first_ns} AND {within.last_ns} AND "
        # Bags have an index of the times: ordering costs a tenth more time, and no memory.
        order = f"ORDER BY timestamp, {'rowid' if has_rowid(self._database) else 'timestamp'}"
        # Rows without a topic are selected with a null time: a second scan would take longer.
        query = (
            f"SELECT CASE WHEN {this_topic} THEN timestamp END, data FROM messages "  # noqa: S608  # only question marks go in
            f"WHERE {in_range}({this_topic} OR {no_topic}) {order}"
        )
        has_others = False
        count = 0
        try:
            for rows, fetch in fetched(self._database.execute(query, parameters)):
                has_others |= len(fetch.times) < rows
                count += len(fetch.times)
                yield fetch
        except (TypeError, UnicodeDecodeError):
            # The index may differ from the rows.
            if self._database.execute("PRAGMA integrity_check(1)").fetchall() != [("ok",)]:
                raise apsw.CorruptError("its index has values of another type") from None
            # SQLite columns have values of any type; this slower query tests each.
            query = (
                f"SELECT timestamp, data FROM messages WHERE {in_range}{is_message} {order} "  # noqa: S608  # only question marks go in
                f"LIMIT -1 OFFSET {count}"
            )
            for _, fetch in fetched(self._database.execute(query, ids)):
                yield fetch
            has_others = True
        if has_others:
            condition = f"{in_range}({this_topic} OR {no_topic}) AND ({is_message}) IS NOT 1"
            self._count_others(channel, this_topic, condition, parameters)

    def _count_others(
        self, channel: Channel, this_topic: str, condition: str, parameters: list[SQLiteValue]
    ) -> None:
        """Count rows that are not messages: of this topic, and of each unknown topic id."""
        query = (
            f"SELECT {this_topic} AS is_this_, CASE WHEN {this_topic} THEN NULL "  # noqa: S608  # no text of others
            "WHEN typeof(topic_id) IN ('integer', 'null') THEN topic_id "
            "ELSE quote(CAST(topic_id AS BLOB)) END AS key_, count(*) "
            f"FROM messages WHERE {condition} GROUP BY is_this_, key_"
        )
        for is_this, key, count in self._database.execute(query, parameters):
            if is_this:
                reason = "their log times or contents are of other types"
                self._lose(channel, reason, int(str(count)))
            else:
                self.losses.note(f"topic id {key}", "no topic has this id", int(str(count)))

    def _recovered(
        self, channel: Channel, ids: list[SQLiteValue], within: TimeRange, done: int, damage: str
    ) -> Iterator[Fetch]:
        """Fetch messages after the first `done` that SQLite can still read, in time order."""
        database, size = self._database, self.path.stat().st_size
        reason = f"its database is damaged ({damage}); what SQLite can read is read"
        limit_steps(database, size)
        stated, first = _indexed_rows(database)
        most = size // _LEAST_ROW
        found = rows_past_damage(database, first, most)
        rows = sorted(found, key=attrgetter("log_ns", "rowid")) if has_rowid(database) else []
        mine = [row for row in rows if row.topic in ids and within.overlaps(row.log_ns, row.log_ns)]
        lost = 0
        for begin in range(done, len(mine), ROWS):
            group = [(row.log_ns, self._data(row, size)) for row in mine[begin : begin + ROWS]]
            whole = [(log_ns, data) for log_ns, data in group if data is not None]
            lost += len(group) - len(whole)
            if whole:
                yield fetch_of(whole)
        lost += max(0, stated - len(rows))
        limit = ""
        if rows and not stated:
            # Of row ids that are missing, some may be of messages that were deleted before.
            rowids = [row.rowid for row in rows]
            between = max(rowids) - min(rowids) + 1 - len(rows)
            before = max(0, min(rowids) - 1)
            lost += min(between + before * (before < most), most - len(rows))
            limit = "at most "
        if lost > 0:
            reason += f", and {limit}{lost} messages of any topic are missing"
        self._lose(channel, f"{reason}; `sqlite3 FILE .recover` may save more")

    def _data(self, row: Row, size: int) -> bytes | None:
        """Return the content of a message; None if SQLite cannot read it in a file of some bytes.

        A longer content would be read from pages in a circle.
        """
        query = "SELECT data FROM messages WHERE rowid = ? AND length(data) <= ?"
        with suppress(apsw.Error):
            for (data,) in self._database.execute(query, (row.rowid, size)):
                return data if isinstance(data, bytes) else None
        return None

    def _lose(self, channel: Channel, reason: str, messages: int | None = None) -> None:
        self.losses.note(f"topic {quoted(channel.topic)}", reason, messages)

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add definitions that channels lack."""
        self._topics = {id_: completed(channel) for id_, channel in self._topics.items()}

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic as JSON, from the metadata table."""
        try:
            rows = self._database.execute("SELECT metadata FROM metadata ORDER BY rowid DESC")
            (text,) = next(rows, ("",))
        except apsw.Error:
            # Older bags have no metadata table.
            text = ""
        custom = custom_data(text) if isinstance(text, str) else {}
        return of_all_topics(custom)

    def close(self) -> None:
        """Close the database."""
        self._database.close()
