"""ROS 1 bags, format 2.0: indexed or not, whole or cut off, plain, bz2 or lz4."""

from __future__ import annotations

import re
from collections import Counter
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

from rosbags.typesys.msg import normalize_msgtype

from quatprop.containers.base import LATEST, Channel, MessageBlock, MessageLog
from quatprop.containers.file_source import source_of
from quatprop.containers.rosbag1.index import BagChunk, BagIndex, read_index
from quatprop.containers.rosbag1.loading import ChunkLoader
from quatprop.containers.rosbag1.rebuild import rebuild_index
from quatprop.containers.rosbag1.records import OP_BAG_HEADER, MalformedRecordError, RecordFile
from quatprop.containers.time_range import TimeRange, parts_within, span_of
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.provenance import METADATA_KEY
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.containers.file_source import FileSource

_MAGIC = re.compile(rb"#ROS(?:BAG|RECORD) V(\d+\.\d+)\n")
_VERSION = "2.0"


class Rosbag1Log(MessageLog):
    """A ROS 1 bag.

    Parameters
    ----------
    log
        The file.

    Attributes
    ----------
    source
        The open file.
    index
        What it holds.

    Raises
    ------
    UnreadableLogError
        It is missing or not permitted.
    UnsupportedLogError
        It is of another format version, or encrypted.
    DamagedLogError
        It has no bag header.
    """

    kind = "bag"

    def __init__(self, log: Path | FileSource) -> None:
        self.source = source_of(log)
        super().__init__(self.source.path)
        self._file = RecordFile(self.source)
        try:
            self.index = index = self._index()
        except BaseException:
            self.close()
            raise
        self.losses = index.losses
        self._chunks = sorted(index.chunks, key=lambda chunk: chunk.first_ns)
        self._channels = self._channels_of(index)
        self._recorded = {
            fields[b"topic"].decode(errors="replace"): fields[METADATA_KEY].decode(errors="replace")
            for fields in index.connections.values()
            if fields.keys() >= {b"topic", METADATA_KEY}
        }

    def _index(self) -> BagIndex:
        """Check magic and bag header, and return the index."""
        line = self._file.at(0, 64).partition(b"\n")[0] + b"\n"
        magic = _MAGIC.fullmatch(line)
        if magic is None:
            raise DamagedLogError(
                self.path, "it does not begin like a ROS 1 bag; check ", Setting("kind")
            )
        version = magic[1].decode()
        if version != _VERSION:
            raise UnsupportedLogError(
                self.path,
                f"its bag format is version {version} and only {_VERSION} is read; "
                "migrate it with `rosbag fix`",
            )
        try:
            header = self._file.record(len(line))
            encryptor = header.fields.get(b"encryptor", b"")
            has_header = header.op == OP_BAG_HEADER
        except MalformedRecordError:
            has_header = False
        if not has_header:
            raise DamagedLogError(self.path, "its bag header is damaged; try `rosbag reindex`")
        if encryptor:
            raise UnsupportedLogError(
                self.path,
                f"it is encrypted with {quoted(encryptor.decode(errors='replace'))}; "
                "decrypt it with `rosbag decrypt`",
            )
        index = read_index(self._file, header)
        if index is None:
            index = BagIndex(end=header.end)
            rebuild_index(self._file, index)
        elif index.end < self._file.size:
            # Another bag was joined to it; its index counts from its own beginning.
            index.begin_bag()
            rebuild_index(self._file, index)
        return index

    def _channels_of(self, index: BagIndex) -> dict[int, Channel]:
        """Return the channel of each connection."""
        channels = {}
        for conn, fields in index.connections.items():
            if fields.keys() >= {b"topic", b"type", b"message_definition"}:
                channels[conn] = Channel(
                    topic=fields[b"topic"].decode(errors="replace"),
                    type_name=normalize_msgtype(fields[b"type"].decode(errors="replace")),
                    encoding="ros1",
                    schema_encoding="ros1msg",
                    schema=fields[b"message_definition"],
                )
        totals = self._totals()
        for conn in totals.keys() - channels.keys():
            self.losses.note(f"connection {conn}", "its connection record is missing", totals[conn])
        return channels

    def _totals(self) -> Counter[int]:
        """Return how many messages each connection has."""
        totals: Counter[int] = Counter()
        for chunk in self._chunks:
            totals.update({conn + chunk.first_conn: n for conn, n in chunk.counts.items()})
        return totals

    def channels(self) -> list[Channel]:
        """Return every channel, in order of topic, with its number of messages."""
        totals = self._totals()
        counts: Counter[Channel] = Counter()
        for conn, channel in self._channels.items():
            counts[channel] += totals[conn]
        channels = (replace(channel, count=count) for channel, count in counts.items())
        return sorted(channels, key=lambda channel: (channel.topic, channel.type_name))

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk, in order of their start."""
        wanted, chunks = self._chunks_of(channel)
        return self._blocks(channel, wanted, chunks)

    def recorded_span(self, channel: Channel) -> TimeRange | None:
        """Return when a channel was recorded; None where the bag has no index."""
        _, chunks = self._chunks_of(channel)
        return span_of(chunks)

    def blocks_within(self, channel: Channel, within: TimeRange) -> Iterator[MessageBlock]:
        """Yield the messages of the chunks that overlap a range of log times."""
        wanted, chunks = self._chunks_of(channel)
        return self._blocks(channel, wanted, parts_within(chunks, within))

    def _chunks_of(self, channel: Channel) -> tuple[set[int], list[BagChunk]]:
        """Return the connections of a channel, and the chunks that hold it, in order of time."""
        wanted = {conn for conn, described in self._channels.items() if described == channel}
        return wanted, [
            chunk for chunk in self._chunks if chunk.inside(wanted) & chunk.counts.keys()
        ]

    def _blocks(
        self, channel: Channel, wanted: set[int], chunks: list[BagChunk]
    ) -> Iterator[MessageBlock]:
        bounds = [*(chunk.first_ns for chunk in chunks), LATEST]
        loader = ChunkLoader(self._file, chunks, wanted)
        done = 0
        with closing(loader.groups()) as groups:
            for group in groups:
                done += len(group.contents)
                block, losses = loader.block(group)
                for loss in losses:
                    self.losses.note(loss.place, loss.reason, loss.messages, channel.topic)
                if block is not None:
                    yield replace(block, not_before_ns=bounds[done])

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic, which its connection may carry, as JSON."""
        return self._recorded

    def close(self) -> None:
        """Close the file."""
        self.source.close()
