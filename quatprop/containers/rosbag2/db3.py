"""ROS 2 bags in SQLite (``.db3``), of every version of its tables."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import apsw
import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from quatprop.containers.base import Channel, MessageBlock, MessageLog
from quatprop.containers.compressed_messages import decompressed, is_compressed
from quatprop.containers.rosbag2.parts import custom_data
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.provenance import of_all_topics
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_ROWS = 256
"""Rows that are fetched together: they fit the processor's cache."""

_FETCHES = 16
"""Fetches in a block, so that decoding costs little per message."""

_BYTES = 4 << 20
"""Bytes from which a block is complete, for large messages."""


class _Fetch(NamedTuple):
    """Rows fetched together: log times, ns, and the lengths and bytes of the messages."""

    times: NDArray[np.int64]
    lengths: NDArray[np.int64]
    data: bytes


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
        """Open the database, read-only."""
        beside = files_beside(self.path)
        if beside:
            try:
                database = _opened(read_only(self.path, beside))
                database.execute("SELECT count(*) FROM sqlite_master").fetchall()
            except apsw.Error as error:
                reason = f"it cannot be applied ({error}); the last messages may be missing"
                self.losses.note(beside[0], reason)
            else:
                return database
        return _opened(read_only(self.path))

    def _columns(self, table: str) -> set[str]:
        rows = self._database.execute("SELECT name FROM pragma_table_info(?)", (table,))
        return {str(name) for (name,) in rows}

    def _read_topics(self) -> dict[int, Channel]:
        """Return the channel of each topic number."""
        if not (
            self._columns("topics") >= {"id", "name", "type", "serialization_format"}
            and self._columns("messages") >= {"topic_id", "timestamp", "data"}
        ):
            raise UnsupportedLogError(
                self.path,
                "it is an SQLite database without the tables of a ROS 2 bag; "
                "name a database that `ros2 bag` recorded",
            )
        definitions = self._definitions()
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics")
        channels = {}
        for number, name, type_name, encoding in rows:
            schema_encoding, schema = definitions.get(str(type_name), ("", b""))
            channels[int(str(number))] = Channel(
                str(name), normalize_msgtype(str(type_name)), str(encoding), schema_encoding, schema
            )
        return channels

    def _definitions(self) -> dict[str, tuple[str, bytes]]:
        """Return language and text of the definition of each type."""
        wanted = {"topic_type", "encoding", "encoded_message_definition"}
        if not self._columns("message_definitions") >= wanted:
            return {}
        rows = self._database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        return {
            str(type_name): (str(encoding), str(definition).encode())
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
        while group := _block_of(fetches):
            block = _combined(group)
            if self._is_zstd or (channel.encoding == "cdr" and is_compressed(block)):
                block, lost = decompressed(block)
                damaged += lost
            if len(block):
                yield block
        if damaged:
            self._lose(channel, "their zstd data is damaged", damaged)

    def _fetches(self, channel: Channel) -> Iterator[_Fetch]:
        """Fetch messages in time order, up to the end or to damage."""
        numbers = [number for number, found in self._topics.items() if found == channel]
        marks = ", ".join("?" * len(numbers))
        # Bags have an index of the times: this order costs a tenth more than none, and no memory.
        query = (
            "SELECT timestamp, data FROM messages "  # noqa: S608  # only question marks go in
            f"WHERE topic_id IN ({marks}) ORDER BY timestamp, rowid"
        )
        count, lost, rows = 0, 0, 64
        damage = None
        cursor = iter(())
        try:
            cursor = self._database.execute(query, numbers)
        except apsw.Error as error:
            damage = error
        while damage is None:
            fetched: list[Any] = []
            try:
                # What comes before an error stays in the list.
                fetched.extend(islice(cursor, rows))
            except apsw.Error as error:
                damage = error
            if not fetched:
                break
            valid = _of_valid_types(fetched)
            count += len(fetched)
            lost += len(fetched) - len(valid)
            if valid:
                stamps, messages = zip(*valid, strict=True)
                fetch = _Fetch(
                    np.fromiter(stamps, np.int64, len(stamps)),
                    np.fromiter(map(len, messages), np.int64, len(messages)),
                    b"".join(messages),
                )
                yield fetch
                rows = min(_ROWS, max(1, _BYTES * len(valid) // (len(fetch.data) + 1)))
        if lost:
            self._lose(channel, "their log times or contents are of other types", lost)
        if damage is not None:
            self._lose(channel, f"what follows message {count} cannot be read ({damage})")

    def _lose(self, channel: Channel, reason: str, messages: int | None = None) -> None:
        self.losses.note(f"topic {quoted(channel.topic)}", reason, messages)

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


def _of_valid_types(rows: list[Any]) -> list[Any]:
    """Return the rows of an integer and bytes; columns of SQLite hold values of any type."""
    stamps, messages = zip(*rows, strict=True)
    if set(map(type, stamps)) == {int} and set(map(type, messages)) == {bytes}:
        return rows
    return [row for row in rows if type(row[0]) is int and type(row[1]) is bytes]


def _block_of(fetches: Iterator[_Fetch]) -> list[_Fetch]:
    """Take the fetches of one block; none at the end."""
    group: list[_Fetch] = []
    size = 0
    for fetch in fetches:
        group.append(fetch)
        size += len(fetch.data)
        if len(group) == _FETCHES or size > _BYTES:
            break
    return group


def _combined(fetches: list[_Fetch]) -> MessageBlock:
    """Combine fetches into one block."""
    times_of, lengths_of, data = zip(*fetches, strict=True)
    times, lengths = np.concatenate(times_of), np.concatenate(lengths_of)
    ends = np.cumsum(lengths)
    buffer = np.frombuffer(b"".join(data), np.uint8)
    return MessageBlock(buffer, ends - lengths, ends, times, times, int(times[-1]))


def files_beside(path: Path) -> list[str]:
    """Return the names of the journal files with changes not yet in the database."""
    return [
        name
        for name in (f"{path.name}-wal", f"{path.name}-journal")
        if (file := path.with_name(name)).is_file() and file.stat().st_size
    ]


def read_only(path: Path, beside: Sequence[str] = ()) -> str:
    """Return the URI that opens a database without changing it or leaving files beside it.

    Parameters
    ----------
    path
        The database.
    beside
        The files of :func:`files_beside`, if they are to be read, too.
    """
    address = f"file:{quote(str(path.absolute()))}?mode=ro"
    # Without this, files are created beside a database in write-ahead mode.
    return address if beside else f"{address}&immutable=1"


def _opened(address: str) -> apsw.Connection:
    return apsw.Connection(address, flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI)
