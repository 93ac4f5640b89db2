"""The topics of a ROS 2 bag in SQLite, with their types and definitions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosbags.typesys.msg import normalize_msgtype

from quatprop.containers.base import Channel
from quatprop.errors import UnsupportedLogError
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from pathlib import Path

    import apsw
    from apsw import SQLiteValue


def columns_of(database: apsw.Connection, table: str) -> dict[str, None]:
    """Return the names of the columns of a table, in order."""
    rows = database.execute("SELECT name FROM pragma_table_info(?)", (table,))
    return {str(name): None for (name,) in rows}


_TABLES = frozenset({"topics", "messages", "message_definitions", "metadata"})
"""That are read."""


def refuse_computed(database: apsw.Connection, path: Path) -> None:
    """Refuse a database in which a table of bags computes what it holds.

    Raises
    ------
    UnsupportedLogError
        It is a view or a virtual table, or has triggers.
    """
    # As blobs, since text that is not UTF-8 is an error otherwise.
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
    # As blobs, since text that is not UTF-8 is an error otherwise.
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
    """Return language and text of the definition of each type."""
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
