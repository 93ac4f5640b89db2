"""Copy the SQLite storage of ROS 2 bags and add messages."""

from __future__ import annotations

import sqlite3
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING

import apsw

from quatprop.containers.rosbag2.sqlite_files import journal_files, open_database
from quatprop.log_copy.rosbag2_metadata import Added
from quatprop.writers.rosbag2.writer import UNSYNCED, insert_messages

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from quatprop.arrays import Int64, Records
    from quatprop.writers.messages.topics import Topic

_STEP = 1 << 12
"""Number of pages that are copied at a time."""


def first_ns(path: Path) -> int:
    """Return the earliest log time of a database, ns; 0 if there is none."""
    with closing(open_database(path, journal_files(path))) as database:
        ((earliest,),) = database.execute("SELECT MIN(timestamp) FROM messages")
    return int(str(earliest)) if earliest else 0


def _copy(source: Path, place: Path) -> None:
    """Copy a database with its write-ahead log."""
    with (
        closing(open_database(source, journal_files(source))) as original,
        closing(apsw.Connection(str(place))) as copy,
        copy.backup("main", original, "main") as backup,
    ):
        while not backup.done:
            backup.step(_STEP)


class SqlitePart:
    """A copy of a database to which messages of one topic are added.

    `source`: the database to copy, with its write-ahead log
    `place`: the path of the copy, which does not exist
    """

    def __init__(self, source: Path, place: Path, topic: Topic) -> None:
        self.added = Added()
        _copy(source, place)
        with ExitStack() as resources:
            self._database = resources.enter_context(closing(sqlite3.connect(place)))
            self._database.execute(UNSYNCED)
            self._topic_id = self._declare(topic)
            resources.pop_all()

    def _declare(self, topic: Topic) -> int:
        """Declare the topic and its type; return the id of the topic."""
        self._insert(
            "message_definitions",
            topic_type=topic.type_name,
            encoding=topic.schema_encoding,
            encoded_message_definition=topic.schema.decode(),
            type_description_hash=topic.digest,
        )
        return self._insert(
            "topics",
            name=topic.name,
            type=topic.type_name,
            serialization_format=topic.encoding,
            offered_qos_profiles=self._no_profiles(),
            type_description_hash=topic.digest,
        )

    def write(self, log_ns: Int64, messages: Records) -> None:
        """Append messages, all of one size, with their log times, ns."""
        insert_messages(self._database, self._topic_id, log_ns, messages)
        self.added.add(log_ns)

    def finish(self, extend: Callable[[str], str]) -> None:
        """Finish the database."""
        if self._columns("metadata"):
            # rosbag2 reads the newest row.
            newest = "SELECT id, metadata FROM metadata ORDER BY id DESC LIMIT 1"
            for id_, text in self._database.execute(newest).fetchall():
                update = "UPDATE metadata SET metadata = ? WHERE id = ?"
                self._database.execute(update, (extend(text), id_))
        self._database.commit()
        self._database.close()

    def close(self) -> None:
        """Close the database; may be called twice."""
        self._database.close()

    def _no_profiles(self) -> str:
        """Return the text for no profiles: an empty list since version 9, no text before."""
        rows = self._database.execute("SELECT * FROM topics LIMIT 1").fetchall()
        return "[]" if any("[]" in row for row in rows) else ""

    def _columns(self, table: str) -> set[str]:
        return {row[1] for row in self._database.execute(f"PRAGMA table_info({table})")}

    def _insert(self, table: str, **values: str) -> int:
        """Insert the values for which a table has columns; return the row's id."""
        columns = self._columns(table)
        values = {name: value for name, value in values.items() if name in columns}
        if not values:
            return 0
        marks = ", ".join("?" * len(values))
        insert = f"INSERT INTO {table} ({', '.join(values)}) VALUES ({marks})"  # noqa: S608  # our names
        return self._database.execute(insert, list(values.values())).lastrowid or 0
