"""Whether the indexes of a ROS 2 bag in SQLite list each message once."""

from __future__ import annotations

from contextlib import suppress

import apsw

from quatprop.text import quoted


def check_indexes(database: apsw.Connection) -> None:
    """Raise an error of SQLite where an index does not list each row once.

    That is told by how many there are, and by the sum of their numbers.
    """
    indexes = _indexes(database)
    if not indexes and database.execute("PRAGMA quick_check(1)").fetchall() != [("ok",)]:
        raise apsw.CorruptError("its pages do not account for all messages")
    what = "count(*), sum(rowid)" if has_rowid(database) else "count(*)"
    for name in indexes:
        quoted_name = name.replace('"', '""')
        rows = _numbers(database, what, f'INDEXED BY "{quoted_name}"')
        # Where no row number is left out these are all. Otherwise the whole table is counted.
        if rows != _consecutive(database) and rows != _numbers(database, what, "NOT INDEXED"):
            raise apsw.CorruptError(f"its index {quoted(name)} does not list all messages")


def _consecutive(database: apsw.Connection) -> list[int]:
    """Return how many rows there are, and the sum of their numbers, if none is left out."""
    if not has_rowid(database):
        return []
    first, last = _numbers(database, "min(rowid), (SELECT max(rowid) FROM messages)")
    count = last - first + 1
    return [count, (first + last) * count // 2]


def _indexes(database: apsw.Connection) -> list[str]:
    """Return the names of the indexes that list all rows."""
    rows = database.execute("SELECT name FROM pragma_index_list('messages') WHERE partial = 0")
    return [str(name) for (name,) in rows]


def _numbers(database: apsw.Connection, expressions: str, how: str = "") -> list[int]:
    rows = database.execute(f"SELECT {expressions} FROM messages {how}")  # noqa: S608  # no text of others
    return [int(str(value or 0)) for value in next(rows)]


def has_rowid(database: apsw.Connection) -> bool:
    """Return whether rows have numbers."""
    with suppress(apsw.SQLError):  # WITHOUT ROWID
        database.execute("SELECT rowid FROM messages LIMIT 0").fetchall()
        return True
    return False
