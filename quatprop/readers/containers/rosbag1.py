"""ROS 1 bags, format 2.0: indexed or not, complete or truncated, plain, bz2 or lz4."""

from __future__ import annotations

import re
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from rosbags.typesys.msg import normalize_msgtype

from quatprop.containers.chunks import ChunkedLog
from quatprop.containers.rosbag1.index import MAGIC, BagChunk, BagIndex, read_index
from quatprop.containers.rosbag1.loading import BagReader, accounts_for_all, prove
from quatprop.containers.rosbag1.rebuild import rebuild_index
from quatprop.containers.rosbag1.records import OP_BAG_HEADER, RecordFile
from quatprop.containers.rosbag1.resync import RECORDS
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.messages.blocks import Channel, MessageBlock, by_topic
from quatprop.messages.definition_sums import definition_of
from quatprop.provenance import METADATA_KEY
from quatprop.stores.compression import UnreadableDataError
from quatprop.text import Remark, Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


_MAGIC = re.compile(rb"#ROS(?:BAG|RECORD) V(\d+\.\d+)\n")
_VERSION = "2.0"
_PLACE = 8
"""Bytes of an offset in the bag header."""


class Rosbag1Log(ChunkedLog[BagChunk]):
    """A ROS 1 bag."""

    kind = "bag"

    def read_index(self) -> None:
        """Read the index of the bag, or rebuild it."""
        self._file = RecordFile(self.source)
        self._use(self._index())

    def _use(self, index: BagIndex) -> None:
        self.index = index
        for loss in index.losses:
            self.losses.note(*loss)
        self._chunks = sorted(index.chunks, key=lambda chunk: chunk.first_ns)
        self._channels = self._channels_of(index)
        self._recorded = {
            fields[b"topic"].decode(errors="replace"): fields[METADATA_KEY].decode(errors="replace")
            for fields in index.connections.values()
            if fields.keys() >= {b"topic", METADATA_KEY}
        }

    def _index(self) -> BagIndex:
        """Check the magic and the bag header, and return the index."""
        line = self._file.source.read(0, 64).partition(b"\n")[0] + b"\n"
        magic = _MAGIC.fullmatch(line)
        if magic is None:
            raise DamagedLogError(
                self.path, f"it does not begin like a ROS 1 bag; check {Setting('kind')}"
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
        except UnreadableDataError:
            has_header = False
        if not has_header:
            raise DamagedLogError(self.path, "its bag header is damaged; try `rosbag reindex`")
        if encryptor:
            raise UnsupportedLogError(
                self.path,
                f"it is encrypted with {quoted(encryptor.decode(errors='replace'))}; "
                "decrypt it with `rosbag decrypt`",
            )
        place = header.fields.get(b"index_pos", b"")
        self._index_place = int.from_bytes(place, "little") if len(place) == _PLACE else 0
        self._begin = header.end if self._is_record(header.end) else header.data
        index = read_index(self._file, header)
        if index is None or self._file.tried(index.end, len(MAGIC)) not in {b"", MAGIC}:
            return self._rebuilt()
        if index.end < self._file.size:
            # Another bag was appended; its index counts from its own beginning.
            index.begin_bag(index.end)
            rebuild_index(self._file, index)
        return index

    def _is_record(self, place: int) -> bool:
        with suppress(UnreadableDataError):
            return place == self._file.size or self._file.record(place).op in RECORDS
        return False

    def _rebuilt(self) -> BagIndex:
        """Return an index that is built from the records of the file."""
        index = BagIndex(end=self._begin)
        rebuild_index(self._file, index)
        if self._index_place > self._file.size and not index.infos and not index.losses:
            reason = f"it ends before its index, which should begin at byte {self._index_place}"
            index.losses.note(f"byte {self._file.size}", reason)
        return index

    def _channels_of(self, index: BagIndex) -> dict[int, Channel]:
        """Return the channel of each connection."""
        channels = {}
        self._doubtful: set[str] = set()
        for conn, fields in index.connections.items():
            if fields.keys() >= {b"topic", b"type", b"message_definition"}:
                topic = fields[b"topic"].decode(errors="replace")
                schema = definition_of(fields)
                if schema is None:
                    self._doubtful.add(topic)
                channels[conn] = Channel(
                    topic=topic,
                    type_name=normalize_msgtype(fields[b"type"].decode(errors="replace")),
                    encoding="ros1",
                    schema_encoding="ros1msg",
                    schema=fields[b"message_definition"] if schema is None else schema,
                )
        totals = self._totals = _totals(self._chunks)
        for conn in totals.keys() - channels.keys():
            self.losses.note(f"connection {conn}", "its connection record is missing", totals[conn])
        return channels

    def channels(self) -> list[Channel]:
        """Return all channels in order of topic, with their number of messages."""
        totals = self._totals
        counts: Counter[Channel] = Counter()
        for conn, channel in self._channels.items():
            counts[channel] += totals[conn]
        return by_topic(replace(channel, count=count) for channel, count in counts.items())

    def chunks_of(self, channel: Channel) -> list[BagChunk]:
        """Return the chunks that have a channel, or whose counts cannot be verified."""
        wanted = self._connections_of(channel)
        others = [each for each in self._chunks if not each.local_ids(wanted) & each.counts.keys()]
        prove(self._file, [chunk for chunk in others if chunk.is_proved is None])
        left_out = {chunk.start for chunk in others if chunk.is_proved}
        return [chunk for chunk in self._chunks if chunk.start not in left_out]

    def read(self, channel: Channel, chunks: Sequence[BagChunk]) -> Iterator[MessageBlock]:
        """Yield the messages of one channel in some chunks."""
        left_out = {chunk.start for chunk in self._chunks} - {chunk.start for chunk in chunks}
        if not self.check_index(chunks):
            chunks = [chunk for chunk in self.chunks_of(channel) if chunk.start not in left_out]
        if channel.topic in self._doubtful:
            what = f"topic {quoted(channel.topic)}: its message definition"
            self.remarks = (
                Remark("definition-md5", f"{what} does not have the MD5 sum that the bag states"),
            )
        wanted = self._connections_of(channel)
        return BagReader(self._file, self.losses, channel.topic, wanted).blocks(chunks)

    def check_index(self, chunks: Sequence[BagChunk]) -> bool:
        """Return whether some chunks have no gaps behind them; if not, rebuild the index."""
        if accounts_for_all(self._file, chunks):
            return True
        try:
            self._use(self._rebuilt())
        except OSError as error:
            raise self.unreadable(error) from error
        return False

    def _connections_of(self, channel: Channel) -> set[int]:
        return {conn for conn, described in self._channels.items() if described == channel}

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic as JSON, from its connection record."""
        return self._recorded


def _totals(chunks: Sequence[BagChunk]) -> Counter[int]:
    """Return the number of messages of each connection."""
    totals: Counter[int] = Counter()
    for chunk in chunks:
        totals.update({conn + chunk.id_offset: n for conn, n in chunk.counts.items()})
    return totals
