"""SQLite storage of ROS 2 bags with messages added."""

from __future__ import annotations

import sqlite3
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING

from quatprop.containers.rosbag2.db3 import not_yet_inside, read_only
from quatprop.writers.messages.ros_types import ros2_types

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.writers.messages.kinds import Message

_STEP = 1 << 12
"""Pages that are copied at a time."""


def first_ns(path: Path) -> int:
    """Return the earliest log time of a database, ns; 0 where there is none."""
    with closing(_original(path)) as database:
        ((found,),) = database.execute("SELECT MIN(timestamp) FROM messages")
    return found or 0


def _original(path: Path) -> sqlite3.Connection:
    """Open a database that is copied, with what has not yet been moved into it."""
    return sqlite3.connect(read_only(path, not_yet_inside(path)), uri=True)


class SqlitePart:
    """A copy of a database to which messages of one topic are added.

    Parameters
    ----------
    source
        What is copied, with what its log has not yet brought into it.
    place
        Where the copy goes; nothing is there.
    message
        What is published where.
    """

    def __init__(self, source: Path, place: Path, message: Message) -> None:
        with ExitStack() as begun:
            self._database = begun.enter_context(closing(sqlite3.connect(place)))
            with closing(_original(source)) as original:
                original.backup(self._database, pages=_STEP)
            self._topic = self._declared(message)
            begun.pop_all()

    def _declared(self, message: Message) -> int:
        """Declare the topic and its type; return the id of the topic."""
        name = message.definition.name
        types = ros2_types()
        definition, _ = types.generate_msgdef(name, ros_version=2)
        described = {"type_description_hash": types.hash_rihs01(name)}
        self._insert(
            "message_definitions",
            {
                "topic_type": name,
                "encoding": "ros2msg",
                "encoded_message_definition": definition,
                **described,
            },
        )
        return self._insert(
            "topics",
            {
                "name": message.place,
                "type": name,
                "serialization_format": "cdr",
                "offered_qos_profiles": self._no_profiles(),
                **described,
            },
        )

    def write(self, log_ns: NDArray[np.int64], messages: NDArray[np.void]) -> None:
        """Append messages that all have one size, and when each was logged, ns."""
        rows = messages.view(f"V{messages.itemsize}").tolist()
        self._database.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
            zip([self._topic] * len(rows), log_ns.tolist(), rows, strict=True),
        )

    def finish(self, metadata: str | None = None) -> None:
        """Finish the database, with what metadata.yaml says, where it repeats that."""
        if metadata is not None:
            self._insert("metadata", {"metadata_version": 9, "metadata": metadata})
        self._database.commit()
        self._database.close()

    def close(self) -> None:
        """Let go of the database; harmless after the end."""
        self._database.close()

    def _no_profiles(self) -> str:
        """Return what stands for no profiles: a list since version 9, nothing before."""
        found = self._database.execute("SELECT * FROM topics LIMIT 1").fetchall()
        return "[]" if any("[]" in row for row in found) else ""

    def _insert(self, table: str, values: Mapping[str, str | int]) -> int:
        """Insert what a table of this version has columns for; return the id of the row."""
        columns = {row[1] for row in self._database.execute(f"PRAGMA table_info({table})")}
        told = {name: value for name, value in values.items() if name in columns}
        if not told:
            return 0
        marks = ", ".join("?" * len(told))
        into = f"INSERT INTO {table} ({', '.join(told)}) VALUES ({marks})"  # noqa: S608  # our names
        return self._database.execute(into, list(told.values())).lastrowid or 0
