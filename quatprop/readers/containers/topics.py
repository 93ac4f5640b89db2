"""Read the messages of a channel from the chunks of a log, for all chunked formats."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import closing
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

import numpy as np

from quatprop.base.errors import UnreadableLogError, os_reason
from quatprop.base.threads import prefetch
from quatprop.base.times import LATEST
from quatprop.readers.containers.message_log import MessageLog
from quatprop.readers.containers.topic_table import TopicTable
from quatprop.readers.messages.blocks import Channel, MessageBlock
from quatprop.readers.messages.columns import raw_messages
from quatprop.readers.tables.model import TimeRange
from quatprop.stores.compression import DecompressionBudget, UnreadableDataError, decompress
from quatprop.stores.file_source import SHARE, FileSource, source_of

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
    from pathlib import Path


# The topics of a message log as tables.


TRANSFORM_LISTS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types with a list of ``geometry_msgs/TransformStamped`` as their only field."""


class TopicLog(MessageLog):
    """A container whose tables are its topics; they are valid while it is open."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._tables: dict[Channel, TopicTable] = {}

    def __exit__(self, *_error: object) -> None:
        for table in self._tables.values():
            table.release()
        self.close()

    def tables(self, topic: str | None = None) -> list[TopicTable]:
        """Return the topics that have messages.

        `topic`: only those of this name; None for all. A ULog topic with a single instance may be
            named without its number: ``sensor_combined`` for ``sensor_combined/0``
        """
        channels = [channel for channel in self.channels() if channel.count != 0]
        if topic is not None:
            named = [channel for channel in channels if channel.topic == topic]
            instances = [
                channel
                for channel in channels
                if channel.encoding == "ulog" and channel.topic.rpartition("/")[0] == topic
            ]
            channels = named or (instances if len(instances) == 1 else [])
        for channel in channels:
            if channel not in self._tables:
                self._tables[channel] = _table_of(self, channel)
        return [self._tables[channel] for channel in channels]


def _table_of(log: MessageLog, channel: Channel) -> TopicTable:
    if channel.type_name in TRANSFORM_LISTS:
        from quatprop.readers.containers.transforms import TransformTable

        return TransformTable(log, channel)
    table = TopicTable(log, channel)
    if channel.encoding == "json":
        from quatprop.readers.messages.json import sample_of

        # JSON has no other definition than its first messages.
        for block in islice(filter(len, table.blocks), 1):
            table.channel = replace(channel, sample=sample_of(raw_messages(block)))
    return table


class TimedPart(Protocol):
    """A part of a log, such as a chunk.

    `first_ns`, `last_ns`: earliest and latest log time, ns; the latest is None if unknown
    """

    first_ns: int
    last_ns: int | None


Chunk = TypeVar("Chunk", bound=TimedPart)
Content = TypeVar("Content")
Item = TypeVar("Item")

GROUP = 1 << 20
"""Bytes of chunks that are loaded together: they stay in the processor's cache until decoded."""

FIRST = 1 << 16
"""Bytes of the first group, small for callers that read only the beginning; each doubles."""

LARGE = 1 << 26
"""Chunks of more bytes are not loaded ahead of their use."""


class ChunkedLog(TopicLog, Generic[Chunk]):
    """A log whose messages are in chunks."""

    def __init__(self, log: Path | FileSource) -> None:
        self.source = source_of(log)
        super().__init__(self.source.path)
        try:
            self.read_index()
        except BaseException as error:
            self.close()
            if isinstance(error, OSError):
                raise self.unreadable(error) from error
            raise

    def unreadable(self, error: OSError) -> UnreadableLogError:
        """Return the error for a file that the operating system cannot read."""
        return UnreadableLogError(self.path, os_reason(error))

    @abstractmethod
    def read_index(self) -> None:
        """Read the channels, chunks and known losses of the file."""

    @abstractmethod
    def chunks_of(self, channel: Channel) -> list[Chunk]:
        """Return the chunks that may have messages of a channel, in order of time."""

    @abstractmethod
    def read(self, channel: Channel, chunks: Sequence[Chunk]) -> Iterator[MessageBlock]:
        """Yield the messages of one channel in some chunks."""

    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk in order of their first times.

        Only chunks that have the channel are read and none is kept, so memory use does not grow
        with the file.
        """
        return self.read(channel, parts_within(self.chunks_of(channel), within))

    def recorded_span(self, channel: Channel) -> TimeRange | None:
        """Return the range of log times of a channel; None if the file has no index of chunks."""
        return span_of(self.chunks_of(channel))

    def close(self) -> None:
        """Close the file."""
        self.source.close()


class ChunkReader(ABC, Generic[Chunk, Content]):
    """Reads the messages of one channel; subclasses load chunks and locate messages in them."""

    def __init__(self, source: FileSource) -> None:
        self.source = source
        self.budget = DecompressionBudget(source.size)

    @abstractmethod
    def is_mixed(self, chunk: Chunk) -> bool:
        """Return whether a chunk is known to have messages of other channels, too."""

    @abstractmethod
    def expected(self, chunk: Chunk, *, is_mixed: bool) -> list[tuple[int, int]]:
        """Return the byte ranges of the file that are read first for a chunk."""

    @abstractmethod
    def size_of(self, chunk: Chunk) -> int:
        """Return the bytes of the decompressed records of a chunk; 0 if unknown."""

    @abstractmethod
    def load(self, chunk: Chunk, *, is_mixed: bool) -> Content:
        """Return a chunk, or the part with the wanted messages. Called in other threads."""

    @abstractmethod
    def indexed(self, content: Content, chunk: Chunk) -> MessageBlock | None:
        """Return the messages of a loaded chunk by its index; None if it is not reliable.

        Called in other threads.
        """

    @abstractmethod
    def messages(self, content: Content, chunk: Chunk) -> MessageBlock | None:
        """Return the messages of a loaded chunk by its records, and record losses."""

    def blocks(self, chunks: Sequence[Chunk]) -> Iterator[MessageBlock]:
        """Yield the messages in some chunks, in the order of the chunks.

        Chunks are read and decompressed ahead, in threads.
        """
        wanted = [(chunk, self.is_mixed(chunk)) for chunk in chunks]
        ranges = [
            each for chunk, is_mixed in wanted for each in self.expected(chunk, is_mixed=is_mixed)
        ]
        self.source.expect([begin for begin, _ in ranges], [end for _, end in ranges])
        bounds = [*(chunk.first_ns for chunk in chunks[1:]), LATEST]
        sized = ((each, self._share(*each)) for each in wanted)
        with closing(load_ahead(sized, self._load)) as loaded:
            for content, chunk, bound in zip(loaded, chunks, bounds, strict=False):
                block: MessageBlock | None
                if isinstance(content, MessageBlock):
                    block = content
                elif (block := self.indexed(content, chunk)) is None:
                    block = self.messages(content, chunk)
                if block:
                    yield replace(block, watermark_ns=bound)

    def _load(self, wanted: tuple[Chunk, bool]) -> Content | MessageBlock:
        """Return a chunk, or copies of the messages of a mixed one, whose memory is then freed."""
        chunk, is_mixed = wanted
        content = self.load(chunk, is_mixed=is_mixed)
        block = self.indexed(content, chunk) if is_mixed else None
        return content if block is None else block.compacted()

    def _share(self, chunk: Chunk, is_mixed: bool) -> int:
        """Return the bytes by which a chunk fills a group: of a mixed chunk little is decoded."""
        size = self.size_of(chunk)
        return size // SHARE if is_mixed and size <= LARGE else size


def span_of(parts: Sequence[TimedPart]) -> TimeRange | None:
    """Return the range of log times of parts in order of time; None if one is unknown."""
    last = [part.last_ns for part in parts if part.last_ns is not None]
    if not parts or len(last) < len(parts):
        return None
    return TimeRange(parts[0].first_ns, max(last))


def parts_within(parts: Sequence[Chunk], within: TimeRange | None) -> Sequence[Chunk]:
    """Return the parts that may overlap a range of log times; None for all."""
    if within is None:
        return parts
    return [p for p in parts if p.last_ns is None or within.overlaps(p.first_ns, p.last_ns)]


def load_ahead(
    sized: Iterable[tuple[Item, int]], load: Callable[[Item], Content]
) -> Generator[Content, None, None]:
    """Load chunks, given with their sizes in bytes, in other threads; yield their contents.

    Each content has memory of its own.
    """

    def load_group(group: tuple[list[Item], bool]) -> Iterable[Content]:
        chunks, is_large = group
        loaded = map(load, chunks)
        # A large chunk is loaded only when it is used.
        return loaded if is_large else [*loaded]

    with closing(prefetch(load_group, in_groups(sized))) as groups:
        for group in groups:
            yield from group


def in_groups(sized: Iterable[tuple[Item, int]]) -> Iterator[tuple[list[Item], bool]]:
    """Yield groups of chunks, and whether each is one large chunk, loaded only when it is used.

    Handing each chunk to a thread by itself would cost as much as decompressing it.
    """
    chunks: list[Item] = []
    filled, limit = 0, min(FIRST, GROUP)
    for chunk, size in sized:
        # A chunk of unknown size counts as a sixteenth of a group.
        share = size or GROUP >> 4
        if chunks and (size > LARGE or filled + share > limit):
            yield chunks, False
            chunks, filled, limit = [], 0, min(GROUP, 2 * limit)
        if size > LARGE:
            yield [chunk], True
        else:
            chunks.append(chunk)
            filled += share
    if chunks:
        yield chunks, False


# Messages that are compressed one by one, as in ROS 2 bags with ``compression_mode: message``.


ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""The first bytes of a compressed message; a message in CDR begins with 0."""

_LOOKED_AT = 5
"""Number of messages that show whether those of a block are compressed: one may be damaged."""


def decompressed(block: MessageBlock, encoding: str, *, is_known: bool) -> tuple[MessageBlock, int]:
    """Decompress zstd messages; return the intact messages and the number of damaged ones."""
    spans = zip(block.starts[:_LOOKED_AT], block.ends[:_LOOKED_AT], strict=True)
    heads = (block.data[start:end][:4].tobytes() for start, end in spans)
    if not is_known and (encoding != "cdr" or ZSTD_MAGIC not in heads):
        return block, 0
    from zstandard import ZstdError, frame_content_size

    data = block.data.data
    messages = []
    intact = []
    for k, (start, end) in enumerate(zip(block.starts.tolist(), block.ends.tolist(), strict=True)):
        message = data[start:end]
        try:
            size = frame_content_size(message)
            messages.append(decompress(message, "zstd", size if size >= 0 else None))
        except (UnreadableDataError, ZstdError):
            continue
        intact.append(k)
    lengths = np.fromiter(map(len, messages), np.int64, len(messages))
    ends = np.cumsum(lengths)
    decompressed_block = replace(
        block.at(np.array(intact, np.intp)),
        data=np.frombuffer(b"".join(messages), np.uint8),
        starts=ends - lengths,
        ends=ends,
    )
    return decompressed_block, len(block) - len(intact)


# Search for the next record of a damaged log, for all record formats.


WINDOW = 1 << 22
"""Bytes searched at a time."""


def first_accepted(
    read: Callable[[int, int], bytes],
    within: tuple[int, int, int],
    candidates: Callable[[bytes], Iterable[int]],
    accepted: Callable[[int], int | None],
    tries: int,
) -> int | None:
    """Return the offset of the first record that is accepted; None if there is none.

    `within`: the range of offsets to search, and the bytes that a candidate may extend behind it
    `candidates`: finds the offsets of candidates in some bytes
    `accepted`: returns the offset of the record at a candidate's offset; None if there is none
    `tries`: number of candidates after which the search ends
    """
    start, stop, behind = within
    for begin in range(start, stop, WINDOW):
        for place in candidates(read(begin, min(WINDOW, stop - begin) + behind)):
            record = accepted(begin + place)
            tries -= 1
            if record is not None or tries == 0:
                return record
    return None
