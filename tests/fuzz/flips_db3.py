"""Small SQLite bags, and the structure of their pages."""

import sqlite3
import struct
import tempfile
from contextlib import closing
from functools import cache
from pathlib import Path

from fuzz.flips import series
from make.formats import ROS2, imus

TITLE = "SQLite"
COUNTED = ()
LEAF_TABLE, INNER_TABLE, LEAF_INDEX, INNER_INDEX = 13, 5, 10, 2
NAMES = {LEAF_TABLE: "table page", INNER_TABLE: "inner table page", LEAF_INDEX: "index page",
         INNER_INDEX: "inner index page"}  # fmt: skip
VALUES = {
    ("table page", 1): "topic", ("table page", 2): "time",
    ("index page", 0): "time", ("index page", 1): "row number",
    ("inner index page", 0): "time", ("inner index page", 1): "row number",
}  # fmt: skip
TABLES = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                    serialization_format TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                      timestamp INTEGER NOT NULL, data BLOB NOT NULL);
INSERT INTO topics VALUES (3, '/imu', 'sensor_msgs/msg/Imu', 'cdr');
"""
INDEX = "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"


@cache
def layouts():
    """Return bags of one topic, of two, of small pages and of large ones, and without an index."""
    return {
        "one topic": _bag(TABLES + INDEX),
        "two topics": _bag(TABLES + INDEX, notes=True),
        "small pages": _bag("PRAGMA page_size = 1024;" + TABLES + INDEX),
        "large pages": _bag("PRAGMA page_size = 32768;" + TABLES + INDEX),
        "no index": _bag(TABLES),
    }


def _bag(tables, *, notes=False):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        with closing(sqlite3.connect(path)) as database, database:
            database.executescript(tables)
            if notes:
                row = (2, "/note", "std_msgs/msg/UInt8", "cdr")
                database.execute("INSERT INTO topics VALUES (?, ?, ?, ?)", row)
            insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)"
            for k, (t_ns, data) in enumerate(imus(ROS2, series())):
                database.execute(insert, (3, t_ns, data))
                if notes and k % 10 == 0:
                    database.execute(insert, (2, t_ns, b"\0\1\0\0\0"))
        return path.read_bytes()


UNNOTICED = {"table page: topic": "a message of another topic"}


def heads(data):
    """Return what each byte is of the heads of the file, of pages and of their cells."""
    names = dict.fromkeys(range(100), "file header")
    (size,) = struct.unpack_from(">H", data, 16)
    for begin in range(0, len(data), size):
        at = begin + (100 if begin == 0 else 0)
        page = NAMES.get(data[at])
        if page is None:
            continue
        (count,) = struct.unpack_from(">H", data, at + 3)
        head = 12 if page.startswith("inner") else 8
        parts = ("kind", "free block", "free block", "number of cells", "number of cells",
                 "begin of cells", "begin of cells", "free bytes", *4 * ("last page",))  # fmt: skip
        names.update({at + k: f"{page}: {parts[k]}" for k in range(head)})
        places = struct.unpack_from(f">{count}H", data, at + head)
        for k in {0, 1, count - 1} & {*range(count)}:
            place = at + head + 2 * k
            names.update(dict.fromkeys(range(place, place + 2), f"{page}: place of a cell"))
            names.update(_cell(data, begin + places[k], data[at], page))
    return names


def _cell(data, at, kind, page):
    """Name the bytes of a cell up to its blob or text."""
    names = {}
    if kind in {INNER_TABLE, INNER_INDEX}:
        names.update(dict.fromkeys(range(at, at + 4), f"{page}: page of a cell"))
        at += 4
    if kind != INNER_TABLE:
        at = _varint(data, at, names, f"{page}: length of a cell")
    if kind in {INNER_TABLE, LEAF_TABLE}:
        at = _varint(data, at, names, f"{page}: row number")
    if kind == INNER_TABLE:
        return names
    stop = at + data[at]
    first, at = at, _varint(data, at, names, f"{page}: length of the head of a row")
    body, place = first + data[first], 0
    while at < stop:
        column, before = place, at
        at = _varint(data, at, names, f"{page}: type of a value")
        code = int.from_bytes(data[before:at], "big")
        length = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)[code] if at - before == 1 and code < 10 else 0
        what = f"{page}: {VALUES.get((page, column), 'value')}"
        names.update(dict.fromkeys(range(body, body + length), what))
        body, place = body + length, place + 1
    return names


def _varint(data, at, names, what):
    """Name the bytes of a number; return where the next one begins."""
    while True:
        names[at] = what
        at += 1
        if data[at - 1] < 0x80:
            return at
