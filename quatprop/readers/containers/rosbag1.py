"""ROS 1 bags, format 2.0: indexed or not, complete or truncated, plain, bz2 or lz4."""

from __future__ import annotations

import re
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from quatprop.base.errors import DamagedLogError, UnsupportedLogError
from quatprop.base.provenance import METADATA_KEY
from quatprop.base.text import Remark, Setting, quoted
from quatprop.base.times import NS_PER_S
from quatprop.readers.containers.message_log import MessageLog
from quatprop.readers.containers.parts import (
    opening,
    parts_within,
    read_parts,
    span_of,
    system_errors,
)
from quatprop.readers.containers.rosbag1_index import (
    HEAD,
    INDEX_ENTRY,
    MAGIC,
    OP_BAG_HEADER,
    OP_CHUNK,
    OP_MESSAGE,
    BagChunk,
    BagIndex,
    ChunkRecords,
    RecordFile,
    fields_of,
    header_end_of,
    index_data,
    index_reader,
    offsets_of,
    read_chunk,
    read_index,
)
from quatprop.readers.containers.rosbag1_rebuild import rebuild_index
from quatprop.readers.containers.rosbag1_walk import RECORDS, surviving_records
from quatprop.readers.messages.blocks import Channel, MessageBlock, by_topic
from quatprop.readers.messages.definitions import definition_of
from quatprop.stores.compression import DecompressionBudget, UnreadableDataError
from quatprop.stores.file_source import LARGE, ranges_worth_reading, source_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.base.errors import Losses
    from quatprop.readers.containers.parts import Loaded, Lost
    from quatprop.readers.containers.rosbag1_index import Record
    from quatprop.readers.tables.model import TimeRange
    from quatprop.stores.file_source import FileSource


# Locate the messages of connections in a decompressed chunk by its index data.


def indexed_messages(
    data: NDArray[np.uint8], offsets: NDArray[np.int64], connections: Collection[int]
) -> MessageBlock | None:
    """Return the indexed messages of some connections; None if the index is wrong.

    All headers are compared with the first to detect a wrong index.

    `data`: the decompressed chunk, shape ``(B,)``
    `offsets`: offsets of their records by the index, shape ``(N,)``, ascending
    """
    if len(offsets) == 0:
        return None
    first, last = int(offsets[0]), int(offsets[-1])
    layout = _message_layout(data.data, first)
    if layout is None or last + layout.itemsize > len(data):
        return None
    size, count = layout.itemsize, len(offsets)
    stride = size + int.from_bytes(data[first + size - 4 : first + size].tobytes(), "little")
    if (offsets[1:] - offsets[:-1] == stride).all():
        every = np.ndarray((count,), f"V{size}", data, first, (stride,)).copy()
    else:
        # An overlapping view gathers the heads in one copy of a few bytes per message, so that the
        # operations below work on a small array instead of the whole chunk.
        every = np.ndarray((len(data) - size + 1,), f"V{size}", data, 0, (1,))[offsets]
        stride = 0
    headers = every.view(layout)
    if not _are_of(headers, connections):
        return None
    starts = offsets + size
    if np.count_nonzero(headers["size"] != stride - size):
        ends, stride = starts + headers["size"], 0
    else:
        ends = starts + (stride - size)
    if int(ends[-1]) > len(data) or (not stride and (offsets[1:] < ends[:-1]).any()):
        return None
    log_ns = _log_ns(headers)
    publishers = headers["conn"].astype(np.int64) if len(connections) > 1 else None
    return MessageBlock(data, starts, ends, log_ns, log_ns, stride=stride, publishers=publishers)


def _are_of(headers: NDArray[np.void], connections: Iterable[int]) -> bool:
    """Return whether all headers are of messages of some connections, and of one layout."""
    count = sum(np.count_nonzero(headers["conn"] == conn) for conn in connections)
    wanted = {"length": headers.dtype.itemsize - 8, "op": OP_MESSAGE}
    return count == len(headers) and not any(
        np.count_nonzero(headers[name] != value) for name, value in wanted.items()
    )


def _log_ns(headers: NDArray[np.void]) -> NDArray[np.int64]:
    log_ns: NDArray[np.int64] = np.multiply(headers["sec"], NS_PER_S, dtype=np.int64)
    log_ns += headers["nsec"]
    return log_ns


def _message_layout(data: memoryview, at: int) -> np.dtype[np.void] | None:
    """Return the layout of the message header at `at`, as offsets from `at`."""
    try:
        header_end = header_end_of(data, at)
        places = {name: (begin - at, end - begin) for name, begin, end in
                  fields_of(data, at + 4, header_end)}  # fmt: skip
        (op, op_size), (conn, conn_size), (time, time_size) = (
            places[name] for name in (b"op", b"conn", b"time")
        )
    except (UnreadableDataError, KeyError):
        return None
    if (op_size, conn_size, time_size) != (1, 4, 8):
        return None
    size = header_end + 4 - at
    return np.dtype(
        {
            "names": ["length", "op", "conn", "sec", "nsec", "size"],
            "formats": ["<u4", "u1", "<u4", "<u4", "<u4", "<u4"],
            "offsets": [0, op, conn, time, time + 4, size - 4],
            "itemsize": size,
        }
    )


# Read the messages of a channel from the chunks of a ROS 1 bag, and record losses.
#
# Bags have no checksums but redundant counts: chunk infos and the index data behind each chunk
# state the number of messages of every connection, and chunks with their index data fill the file.


_INDEX_HEAD = 55
"""Usual bytes of an index data record before its entries."""


class BagReader:
    """Reads the messages of one channel; see :class:`.PartReader`.

    `topic`, `connections`: the topic of the channel, and the ids of its connections
    """

    def __init__(self, file: RecordFile, losses: Losses, topic: str, connections: set[int]) -> None:
        self.file, self.topic, self.connections = file, topic, connections
        self.budget = DecompressionBudget(file.source.size)
        self.note = losses.note
        self._is_plain: bool | None = None

    def is_mixed(self, part: BagChunk) -> bool:
        """Return whether a chunk has other connections."""
        own = part.local_ids(self.connections)
        return not part.is_unchunked and not part.counts.keys() <= own

    def expected(self, part: BagChunk) -> list[tuple[int, int]]:
        """Return the byte range of a chunk, or of its head if it is read in part."""
        head_end = part.start + HEAD
        if part.end - part.start >= LARGE and self.is_mixed(part):
            if self._is_plain is None:
                self._is_plain = _is_plain(record_of(self.file, part))
            if self._is_plain:
                return [(part.start, head_end)]
        return [(part.start, max(part.end, head_end))]

    def size_of(self, part: BagChunk) -> int:
        """Return the bytes of the records of a chunk by its head; 0 if unknown."""
        if part.is_unchunked:
            return part.end - part.start
        record = record_of(self.file, part)
        if record is None:
            return 0
        return record.end - record.data if _is_plain(record) else record.number(b"size")

    def load(self, part: BagChunk) -> Loaded:
        """Return the messages of the channel in a chunk, and what of it is lost."""
        inside = part.local_ids(self.connections)
        is_large = part.end - part.start >= LARGE
        if is_large and self.is_mixed(part) and self._is_indexed(part, part.counts):
            block = self._selected(part, inside)
            if block is not None:
                return _of_part(block, part), []
        content = self._content(part)
        counts = {conn: len(rows) for conn, rows in content.entries.items() if conn in inside}
        expected = {conn: n for conn, n in part.counts.items() if conn in inside}
        is_doubtful = content.damage or part.is_resized
        if not is_doubtful and self._is_indexed(part, counts) and counts == expected:
            offsets = offsets_of(content.entries, inside)
            block = indexed_messages(content.data, offsets, inside)
            if block is not None:
                return _of_part(block, part), []
        block, damage = _scanned(content, inside)
        missing = sum(expected.values()) - len(block)
        lost: list[Lost] = []
        if damage or missing > 0:
            reason = damage or "it has fewer messages than it says"
            lost.append((part.place, reason, missing or None, self.topic))
        return _of_part(block, part), lost

    def _content(self, chunk: BagChunk) -> ChunkRecords:
        if chunk.is_missing:
            return ChunkRecords(damage="a part of it is missing")
        try:
            self.budget.check()
            loaded = read_chunk(self.file, chunk, record_of(self.file, chunk))
        except UnreadableDataError as error:
            return ChunkRecords(damage=str(error))
        self.budget.spend(0 if chunk.is_unchunked else len(loaded.data))
        return loaded

    def _selected(self, chunk: BagChunk, inside: set[int]) -> MessageBlock | None:
        """Return only the wanted messages of a chunk; None if it is better read whole.

        That is, if it is compressed or mostly wanted, or its index data and chunk info disagree.
        """
        record = record_of(self.file, chunk)
        if record is None or not _is_plain(record) or record.end > chunk.end:
            return None
        size = record.end - record.data
        entries = ChunkRecords(read_index=index_reader(self.file, chunk, record, size)).entries
        indexed = offsets_of(entries)
        is_double = (indexed[1:] == indexed[:-1]).any()
        if is_double or {conn: len(rows) for conn, rows in entries.items()} != chunk.counts:
            return None
        begins = offsets_of(entries, inside)
        nexts = np.append(indexed, size)[np.searchsorted(indexed, begins, "right")]
        ranges = ranges_worth_reading(begins, nexts, size)
        if ranges is None:
            return None
        places = record.data + ranges.begins, record.data + ranges.ends
        data = np.frombuffer(self.file.at_ranges(*(each.tolist() for each in places)), np.uint8)
        return indexed_messages(data, begins - ranges.moved, inside)

    def _is_indexed(self, chunk: BagChunk, indexed: Collection[int]) -> bool:
        """Return whether an index is certain to list all messages of the wanted connections.

        Without chunk infos, the index may list messages under the id of another connection.
        """
        return chunk.is_proved is not False or chunk.local_ids(self.connections) <= {*indexed}


def _is_plain(record: Record | None) -> bool:
    return record is None or record.fields[b"compression"] == b"none"


def _scanned(content: ChunkRecords, wanted: set[int]) -> tuple[MessageBlock, str]:
    """Locate messages record by record; return them and the damage, or ``""``."""
    records, damage = surviving_records(content)
    rows = [
        (record.data, record.end, record.time(b"time"), record.number(b"conn"))
        for record in records
        if record.op == OP_MESSAGE and record.number(b"conn") in wanted
    ]
    starts, ends, log_ns, publishers = np.array(rows, np.int64).reshape(-1, 4).T.copy()
    block = MessageBlock(content.data, starts, ends, log_ns, log_ns, publishers=publishers)
    return block, content.damage or damage


def _of_part(block: MessageBlock, chunk: BagChunk) -> MessageBlock:
    """Return the messages of a chunk with the numbers of connections in the whole file."""
    if block.publishers is None or not chunk.id_offset:
        return block
    return replace(block, publishers=block.publishers + chunk.id_offset)


def accounts_for_all(file: RecordFile, chunks: Sequence[BagChunk]) -> bool:
    """Return whether each of some chunks and its index data end where the next chunk begins."""
    unchecked = [chunk for chunk in chunks if not chunk.is_checked]
    begins = [chunk.start for chunk in unchecked]
    file.source.expect(begins, [begin + HEAD for begin in begins])
    for chunk in unchecked:
        chunk.is_checked = _has_no_gap_behind(file, chunk)
        if not chunk.is_checked:
            return False
    return True


def prove(file: RecordFile, chunks: Sequence[BagChunk]) -> None:
    """Set `is_proved` of chunks: whether their index data agree with their chunk infos."""
    begins = [chunk.start for chunk in chunks]
    file.source.expect(begins, [begin + HEAD for begin in begins])
    ends = [record.end if (record := record_of(file, chunk)) else chunk.end for chunk in chunks]
    file.source.expect(
        ends, [max(pair) for pair in zip((c.end for c in chunks), ends, strict=True)]
    )
    for chunk in chunks:
        chunk.is_proved = _matches_index(file, chunk)


def record_of(file: RecordFile, chunk: BagChunk) -> Record | None:
    """Return the record of a chunk; None if it is missing or incomplete."""
    if chunk.record is None and not chunk.is_missing:
        try:
            record = file.record(chunk.start)
            record.number(b"size")
            is_chunk = record.op == OP_CHUNK and b"compression" in record.fields
        except UnreadableDataError:
            return None
        if is_chunk and record.end <= file.size:
            chunk.record = record
    return chunk.record


def _has_no_gap_behind(file: RecordFile, chunk: BagChunk) -> bool:
    record = record_of(file, chunk)
    if record is None:
        return False
    size = sum(_INDEX_HEAD + INDEX_ENTRY.itemsize * count for count in chunk.counts.values())
    return record.end + size == chunk.end or _matches_index(file, chunk)


def _matches_index(file: RecordFile, chunk: BagChunk) -> bool:
    """Return whether index data fill the space behind a chunk and agree with its chunk info."""
    record = record_of(file, chunk)
    # They are shorter than the messages, unless these are empty.
    if record is None or not 0 <= chunk.end - record.end <= 2 * record.number(b"size"):
        return False
    try:
        data = file.at(record.end, chunk.end - record.end)
    except UnreadableDataError:
        return False
    entries, end = index_data(data)
    return end == len(data) and {conn: len(rows) for conn, rows in entries.items()} == chunk.counts


_MAGIC = re.compile(rb"#ROS(?:BAG|RECORD) V(\d+\.\d+)\n")
_VERSION = "2.0"
_PLACE = 8
"""Bytes of an offset in the bag header."""


class Rosbag1Log(MessageLog):
    """A ROS 1 bag."""

    kind = "bag"

    def __init__(self, log: Path | FileSource) -> None:
        self.source = source_of(log)
        super().__init__(self.source.path)
        with opening(self.source):
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

    def parts(self, channel: Channel) -> list[BagChunk]:
        """Return the chunks that have a channel, or whose counts cannot be verified."""
        wanted = self._connections_of(channel)
        others = [each for each in self._chunks if not each.local_ids(wanted) & each.counts.keys()]
        prove(self._file, [chunk for chunk in others if chunk.is_proved is None])
        left_out = {chunk.start for chunk in others if chunk.is_proved}
        return [chunk for chunk in self._chunks if chunk.start not in left_out]

    def recorded_span(self, channel: Channel) -> TimeRange | None:
        """Return the range of log times of a channel; None if the bag has no index."""
        return span_of(self.parts(channel))

    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk in order of their first times."""
        chunks = parts_within(self.parts(channel), within)
        left_out = {chunk.start for chunk in self._chunks} - {chunk.start for chunk in chunks}
        if not self.check_index(chunks):
            chunks = [chunk for chunk in self.parts(channel) if chunk.start not in left_out]
        if channel.topic in self._doubtful:
            what = f"topic {quoted(channel.topic)}: its message definition"
            self.remarks = (
                Remark("definition-md5", f"{what} does not have the MD5 sum that the bag states"),
            )
        wanted = self._connections_of(channel)
        reader = BagReader(self._file, self.losses, channel.topic, wanted)
        return read_parts(self.source, chunks, reader)

    def check_index(self, chunks: Sequence[BagChunk]) -> bool:
        """Return whether some chunks have no gaps behind them; if not, rebuild the index."""
        if accounts_for_all(self._file, chunks):
            return True
        with system_errors(self.path):
            self._use(self._rebuilt())
        return False

    def _connections_of(self, channel: Channel) -> set[int]:
        return {conn for conn, described in self._channels.items() if described == channel}

    def publishers(self, channel: Channel) -> dict[int, str]:
        """Return the nodes that published a channel, by the numbers of connections."""
        nodes = {
            conn: fields.get(b"callerid", b"").decode(errors="replace") or f"connection-{conn}"
            for conn, fields in self.index.connections.items()
            if conn in self._connections_of(channel)
        }
        return nodes if len({*nodes.values()}) > 1 else {}

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic as JSON, from its connection record."""
        return self._recorded

    def close(self) -> None:
        """Close the file."""
        self.source.close()


def _totals(chunks: Sequence[BagChunk]) -> Counter[int]:
    """Return the number of messages of each connection."""
    totals: Counter[int] = Counter()
    for chunk in chunks:
        totals.update({conn + chunk.id_offset: n for conn, n in chunk.counts.items()})
    return totals
