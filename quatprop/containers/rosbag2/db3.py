"""ROS 2 bags in SQLite (``.db3``), of every version of its tables."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import apsw
import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from quatprop.containers.base import Channel, MessageBlock, MessageLog
from quatprop.containers.packed_messages import is_packed, unpacked
from quatprop.containers.rosbag2.parts import custom_data
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.provenance import of_all_topics
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_ROWS = 256
"""Rows that are fetched together: enough to share the costs, few enough to stay in the cache."""

_FETCHES = 16
"""Fetches that make a block: enough to share the costs of decoding it."""

_BYTES = 4 << 20
"""Bytes above which a block is not made larger, for large messages."""


class _Fetch(NamedTuple):
    """Rows that were fetched together: times, ns, and lengths and bytes of the messages."""

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
        ``"zstd"`` where each message is packed by itself. Messages in CDR tell that themselves.

    Raises
    ------
    DamagedLogError
        It is no database, or damaged where it says what it holds.
    UnsupportedLogError
        It is a database of something else, or of a compression that is not read.
    """

    kind = "db3"

    def __init__(self, path: Path, message_compression: str | None = None) -> None:
        if message_compression not in (None, "zstd"):
            raise UnsupportedLogError(
                path,
                f"its messages are packed with {quoted(message_compression)} and only zstd is "
                "read; unpack it with `ros2 bag convert`",
            )
        super().__init__(path)
        self._packed = message_compression is not None
        try:
            self._database = self._connected()
            try:
                self._topics = self._described()
            except BaseException:
                self._database.close()
                raise
        except (apsw.Error, UnicodeDecodeError) as error:
            raise DamagedLogError(
                path, f"its database cannot be read ({error}); try `sqlite3 FILE .recover`"
            ) from error

    def _connected(self) -> apsw.Connection:
        """Open the database without ever writing to it."""
        beside = not_yet_inside(self.path)
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

    def _described(self) -> dict[int, Channel]:
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
        """Return how the definition of each type is written, and the definition."""
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
        """Return every channel, in order of topic; SQLite does not say how many messages it has."""
        return sorted(
            set(self._topics.values()), key=lambda channel: (channel.topic, channel.type_name)
        )

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, in order of their log times."""
        fetches = self._fetches(channel)
        damaged = 0
        while some := _some(fetches):
            block = _joined(some)
            if self._packed or (channel.encoding == "cdr" and is_packed(block)):
                block, lost = unpacked(block)
                damaged += lost
            if len(block):
                yield block
        if damaged:
            self._lose(channel, "their zstd data is damaged", damaged)

    def _fetches(self, channel: Channel) -> Iterator[_Fetch]:
        """Fetch messages in time order, until the end or the damage."""
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
            right = _of_right_types(fetched)
            count += len(fetched)
            lost += len(fetched) - len(right)
            if right:
                stamps, messages = zip(*right, strict=True)
                fetch = _Fetch(
                    np.fromiter(stamps, np.int64, len(stamps)),
                    np.fromiter(map(len, messages), np.int64, len(messages)),
                    b"".join(messages),
                )
                yield fetch
                rows = min(_ROWS, max(1, _BYTES * len(right) // (len(fetch.data) + 1)))
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


def _of_right_types(rows: list[Any]) -> list[Any]:
    """Return the rows of a whole number and bytes; SQLite takes anything.

    Of the digits in bytes numpy would make a number.
    """
    stamps, messages = zip(*rows, strict=True)
    if set(map(type, stamps)) == {int} and set(map(type, messages)) == {bytes}:
        return rows
    return [row for row in rows if type(row[0]) is int and type(row[1]) is bytes]


def _some(fetches: Iterator[_Fetch]) -> list[_Fetch]:
    """Take as many fetches as make a block; none at the end."""
    some: list[_Fetch] = []
    size = 0
    for fetch in fetches:
        some.append(fetch)
        size += len(fetch.data)
        if len(some) == _FETCHES or size > _BYTES:
            break
    return some


def _joined(fetches: list[_Fetch]) -> MessageBlock:
    """Return fetches as one block."""
    every, sizes, data = zip(*fetches, strict=True)
    times, lengths = np.concatenate(every), np.concatenate(sizes)
    ends = np.cumsum(lengths)
    buffer = np.frombuffer(b"".join(data), np.uint8)
    return MessageBlock(buffer, ends - lengths, ends, times, times, int(times[-1]))


def not_yet_inside(path: Path) -> list[str]:
    """Name the files beside a database with what a recorder has not yet moved into it."""
    return [
        name
        for name in (f"{path.name}-wal", f"{path.name}-journal")
        if (file := path.with_name(name)).is_file() and file.stat().st_size
    ]


def read_only(path: Path, beside: Sequence[str] = ()) -> str:
    """Return the address that opens a database and neither changes it nor leaves files beside it.

    Parameters
    ----------
    path
        The database.
    beside
        The files of :func:`not_yet_inside` where they are to be read, too.
    """
    address = f"file:{quote(str(path.absolute()))}?mode=ro"
    # Opened without this, a database in write-ahead mode gets files of its own beside it.
    return address if beside else f"{address}&immutable=1"


def _opened(address: str) -> apsw.Connection:
    return apsw.Connection(address, flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI)
