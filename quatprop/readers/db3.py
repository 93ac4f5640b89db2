"""ROS 2 bags in SQLite (``.db3``), of every version of its tables."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING
from urllib.parse import quote

import apsw
import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from quatprop.errors import DamagedLogError, UnsupportedLogError, quoted
from quatprop.readers.base import Channel, Loss, MessageBlock
from quatprop.readers.packed_messages import is_packed, joined, together, unpacked

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType
    from typing import Self

_ROWS = 512
"""Rows that are fetched together: enough to share the costs, few enough to stay in the cache."""

_PIECES = 8
"""Fetches that make a block: enough to share the costs of decoding it."""

_BYTES = 4 << 20
"""Bytes above which a block is not made larger, for large messages."""


class Db3Log:
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
        self.path = path
        self.losses: list[Loss] = []
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
        address = f"file:{quote(str(self.path.absolute()))}?mode=ro"
        beside = [
            name
            for name in (f"{self.path.name}-wal", f"{self.path.name}-journal")
            if (file := self.path.with_name(name)).is_file() and file.stat().st_size
        ]
        if beside:
            # What a recorder that is running, or died, has not yet moved into the database.
            try:
                database = _opened(address)
                database.execute("SELECT count(*) FROM sqlite_master").fetchall()
            except apsw.Error as error:
                reason = f"it cannot be applied ({error}); the last messages may be missing"
                self.losses.append(Loss(beside[0], reason))
            else:
                return database
        return _opened(f"{address}&immutable=1")

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
        pieces: list[MessageBlock] = []
        for piece in self._pieces(channel):
            pieces.append(piece)
            if len(pieces) == _PIECES or sum(len(one.data) for one in pieces) > _BYTES:
                yield together(pieces)
                pieces.clear()
        if pieces:
            yield together(pieces)

    def _pieces(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield messages as they are fetched, until the end or the damage."""
        numbers = [number for number, found in self._topics.items() if found == channel]
        marks = ", ".join("?" * len(numbers))
        # Bags have an index of the times: this order costs a tenth more than none, and no memory.
        query = (
            "SELECT timestamp, data FROM messages "  # noqa: S608  # only question marks go in
            f"WHERE topic_id IN ({marks}) ORDER BY timestamp, rowid"
        )
        count, damaged, rows = 0, 0, 64
        try:
            cursor = self._database.execute(query, numbers)
            while fetched := list(islice(cursor, rows)):
                stamps, messages = zip(*fetched, strict=True)
                times = np.fromiter(stamps, np.int64, len(stamps))
                block = joined(messages, times, times, int(times[-1]))
                count += len(fetched)
                rows = min(_ROWS, max(1, _BYTES * len(fetched) // (len(block.data) + 1)))
                if self._packed or (channel.encoding == "cdr" and is_packed(block)):
                    block, lost = unpacked(block)
                    damaged += lost
                if len(block):
                    yield block
        except (apsw.Error, TypeError, OverflowError) as error:
            self._lose(channel, f"what follows message {count} cannot be read ({error})")
        if damaged:
            self._lose(channel, "their zstd data is damaged", damaged)

    def _lose(self, channel: Channel, reason: str, messages: int | None = None) -> None:
        loss = Loss(f"topic {quoted(channel.topic)}", reason, messages)
        # The log may be read more than once.
        if loss not in self.losses:
            self.losses.append(loss)

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None:
        self.close()


def _opened(address: str) -> apsw.Connection:
    return apsw.Connection(address, flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI)
