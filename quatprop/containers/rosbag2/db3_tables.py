"""The tables of a ROS 2 bag in SQLite: topics, and a check of the indexes."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import apsw
from rosbags.typesys.msg import normalize_msgtype

from quatprop.errors import UnsupportedLogError
from quatprop.messages.blocks import Channel
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from pathlib import Path

    from apsw import SQLiteValue


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


def has_rowid(database: apsw.Connection) -> bool:
    """Return whether rows have row ids."""
    with suppress(apsw.SQLError):  # WITHOUT ROWID
        database.execute("SELECT rowid FROM messages LIMIT 0").fetchall()
        return True
    return False
