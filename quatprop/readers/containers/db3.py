"""ROS 2 bags in SQLite (``.db3``), all versions of the tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import apsw

from quatprop.containers.compressed_messages import decompressed
from quatprop.containers.rosbag2.db3_tables import check_indexes, columns_of, has_rowid, read_topics
from quatprop.containers.rosbag2.fetches import ROWS, Fetch, combined, fetch_of, fetched, next_group
from quatprop.containers.rosbag2.parts import custom_data
from quatprop.containers.rosbag2.sqlite_files import (
    journal_files,
    limit_steps,
    note_joined_bytes,
    open_database,
    read_wal,
)
from quatprop.containers.rosbag2.sqlite_pages import open_pages
from quatprop.containers.topics import TopicLog
from quatprop.errors import DamagedLogError
from quatprop.messages.blocks import Channel, MessageBlock, by_topic
from quatprop.provenance import of_all_topics
from quatprop.stores.file_source import FileSource
from quatprop.tables.model import TimeRange
from quatprop.text import quoted
from quatprop.times import LATEST

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from apsw import SQLiteValue


EVERY_TIME = TimeRange(-LATEST, LATEST)
"""All log times: with this range, rows without a valid time are counted as lost."""


class Db3Log(TopicLog):
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
        """Open the database, read-only, with the journal files beside it."""
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
                pages = read_wal(wal).unfinished
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
        """Fetch messages in time order; if SQLite fails, read the pages of the file instead."""
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
        """Fetch messages after the first `done` from the pages of the file, in time order."""
        names = list(columns_of(self._database, "messages"))
        topic, time, data = (names.index(name) for name in ("topic_id", "timestamp", "data"))
        with open_pages(self.path, (topic, time, data)) as pages:
            cells = sorted({cell[:3]: cell for cell in pages.cells(self._topics)}.values())
            lost = 0
            if cells:
                rowids = [cell.rowid for cell in cells]
                lost = max(rowids) - min(0, min(rowids) - 1) - len(cells)
            mine = [
                cell
                for cell in cells
                if cell.group in ids and within.overlaps(cell.log_ns, cell.log_ns)
            ][done:]
            for first in range(0, len(mine), ROWS):
                group = [(c.log_ns, pages.blob(c)) for c in mine[first : first + ROWS]]
                whole = [(log_ns, data) for log_ns, data in group if data is not None]
                lost += len(group) - len(whole)
                if whole:
                    yield fetch_of(whole)
        reason = f"its database is damaged ({damage}); what intact pages hold is read"
        if lost > 0:
            reason += f", and {lost} messages of any topic between them are missing"
        self._lose(channel, reason)

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
