"""Copy ROS 2 bags, folders or single databases, and add attitudes."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING

import apsw
import numpy as np

from quatprop.base.errors import OutputError, UnsupportedLogError
from quatprop.base.text import Setting, plain
from quatprop.readers.containers.mcap import McapLog
from quatprop.readers.containers.rosbag2_parts import METADATA, folder
from quatprop.readers.containers.sqlite import journal_files, open_database
from quatprop.writers import attitude_encoder
from quatprop.writers.atomic import OutputPath
from quatprop.writers.base import MessageWriter, provenance_json
from quatprop.writers.into.mcap_copy import Added, McapPart, extended, extended_record
from quatprop.writers.rosbag2 import UNSYNCED, insert_messages

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from quatprop.base.arrays import Int64, Records
    from quatprop.readers.containers.message_log import MessageLog
    from quatprop.writers.formats import Message
    from quatprop.writers.message_encoders import Topic


# Copy the SQLite storage of ROS 2 bags and add messages.


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


_LATEST = int(np.iinfo(np.int64).max)


class Rosbag2CopyWriter(MessageWriter):
    """Copy a ROS 2 bag and add each attitude to the part of its time."""

    _output: OutputPath

    def __init__(self, log: MessageLog, target: Path | str, message: Message) -> None:
        self._message = message
        self.encoder = attitude_encoder(message, ("cdr",))
        self._source = log.path
        self._files = _files(log.path)
        self._parts: list[McapPart | SqlitePart] = []
        self._part_log = ExitStack()
        is_folder = log.path.is_dir()
        super().__init__(OutputPath(target, folder=is_folder))
        with self._opening():
            # Messages before the start of the next part that has any belong to this one.
            ends = [_LATEST]
            for file in reversed(self._files[1:]):
                ends.append(_first_ns(file) or ends[-1])
            self._ends = ends[::-1]
            if is_folder:
                self._output.path.mkdir()
                self._copy_other_files()
            self._open_next()

    def _write(self, log_ns: Int64, messages: Records) -> None:
        """Append messages to one or several parts."""
        while len(log_ns):
            end = self._ends[len(self._parts) - 1]
            count = int(np.searchsorted(log_ns, end)) if end != _LATEST else len(log_ns)
            if count:
                self._parts[-1].write(log_ns[:count], messages[:count])
            log_ns, messages = log_ns[count:], messages[count:]
            if len(log_ns):
                self._finish_part({})
                self._open_next()

    def _finish(self, provenance: Mapping[str, object]) -> None:
        """Copy the rest of the log and finish the bag with its provenance."""
        custom = {f"quatprop {self.encoder.topic.name}": provenance_json(provenance)}
        while len(self._parts) < len(self._files):
            self._finish_part({})
            self._open_next()
        self._write_metadata(custom)
        self._finish_part(custom)

    def abort(self) -> None:
        """Discard uncommitted output."""
        for part in self._parts[-1:]:
            part.close()
        self._part_log.close()
        super().abort()

    def _write_metadata(self, custom: Mapping[str, str]) -> None:
        """Write metadata.yaml if the bag has one.

        If it is damaged, which the reader reports, it is omitted: parts are found by file name.
        """
        place = self._source / METADATA
        if place.is_file():
            text = place.read_text(encoding="utf-8")
            if copied := extended(text, self.encoder.topic, self._added(), custom):
                (self._output.path / METADATA).write_text(copied, encoding="utf-8")

    def _added(self) -> list[Added]:
        return [part.added for part in self._parts]

    def _copy_other_files(self) -> None:
        """Copy the files of the folder that are not part of the bag."""
        names = {file.name for file in self._files} | {METADATA}
        names |= {name + end for name in names for end in ("-wal", "-shm")}
        for file in sorted(self._source.iterdir()):
            if file.is_file() and file.name not in names:
                shutil.copyfile(file, self._output.path / file.name)

    def _open_next(self) -> None:
        source = self._files[len(self._parts)]
        place = self._output.path
        place = place / source.name if self._source.is_dir() else place
        if source.suffix == ".mcap":
            with ExitStack() as opened:
                log = opened.enter_context(McapLog(source))
                self._parts.append(McapPart(log, place, self._message))
                self._part_log = opened.pop_all()
        else:
            self._parts.append(SqlitePart(source, place, self.encoder.topic))

    def _finish_part(self, custom: Mapping[str, str]) -> None:
        topic, added = self.encoder.topic, self._added()
        self._parts[-1].finish(lambda text: extended_record(text, topic, added, custom))
        self._part_log.close()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn errors of the operating system and of SQLite into an OutputError."""
        with super()._errors():
            try:
                yield
            except (sqlite3.Error, apsw.Error) as error:
                raise OutputError(
                    self._output.target,
                    f"{plain(self._source)} cannot be copied: {error}; write the attitudes to a "
                    f"file of their own with {Setting('output')}",
                ) from error


def _files(path: Path) -> list[Path]:
    """Return the files of a bag in their order."""
    if not path.is_dir():
        return [path]
    bag = folder(path)
    compressed = [file for file in bag.parts if file.suffix not in {".mcap", ".db3"}]
    if compressed or bag.message_compression:
        raise UnsupportedLogError(
            path,
            "its files or messages are compressed one by one, and nothing can be added to them; "
            "decompress it with `ros2 bag convert`, or write the attitudes to a file of their own "
            f"with {Setting('output')}",
        )
    return bag.parts


def _first_ns(file: Path) -> int:
    if file.suffix != ".mcap":
        return first_ns(file)
    with McapLog(file) as log:
        return min((chunk.first_ns for chunk in log.index.chunks), default=0)
