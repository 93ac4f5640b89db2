"""Read the messages of a channel in the chunks of a log, whichever format it has."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from quatprop.containers.base import LATEST, Channel, MessageBlock, MessageLog
from quatprop.containers.file_source import FileSource, source_of
from quatprop.containers.limits import DecompressionBudget
from quatprop.containers.loading import LARGE, load_ahead
from quatprop.containers.time_range import TimedPart, TimeRange, parts_within, span_of
from quatprop.errors import UnreadableLogError, os_reason

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.containers.compression import Buffer

    Bytes = NDArray[np.uint8]


Chunk = TypeVar("Chunk", bound=TimedPart)


class ChunkedLog(MessageLog, Generic[Chunk]):
    """A file whose messages are in chunks.

    Parameters
    ----------
    log
        The file.

    Attributes
    ----------
    source
        The open file.

    Raises
    ------
    UnreadableLogError
        It is missing or may not be read.
    """

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
        """Return the error of a file that the system does not read."""
        return UnreadableLogError(self.path, os_reason(error))

    @abstractmethod
    def read_index(self) -> None:
        """Read what the file holds and where; also its losses so far."""

    @abstractmethod
    def chunks_of(self, channel: Channel) -> list[Chunk]:
        """Return the chunks that may hold a channel, in order of time."""

    @abstractmethod
    def read(self, channel: Channel, chunks: Sequence[Chunk]) -> Iterator[MessageBlock]:
        """Yield the messages of one channel in some chunks."""

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk in order of their first times.

        Only chunks that hold the channel are read, and none is kept, so memory use does not grow
        with the file.

        Parameters
        ----------
        channel
            One of :meth:`channels`.

        Yields
        ------
        MessageBlock
            The messages of one chunk or several, in the order of the chunks.
        """
        return self.read(channel, self.chunks_of(channel))

    def recorded_span(self, channel: Channel) -> TimeRange | None:
        """Return when a channel was recorded; None where the file has no index of chunks."""
        return span_of(self.chunks_of(channel))

    def blocks_within(self, channel: Channel, within: TimeRange) -> Iterator[MessageBlock]:
        """Yield the messages of the chunks that overlap a range of log times."""
        return self.read(channel, parts_within(self.chunks_of(channel), within))

    def close(self) -> None:
        """Close the file."""
        self.source.close()


@dataclass(frozen=True, eq=False)
class ChunkContent:
    """What was loaded of a chunk.

    Parameters
    ----------
    data
        Its decompressed records, as far as they could be read.
    damage
        Why they end early, or ``""``.
    offsets
        Where the selected messages begin in `data`, which holds copies of them and little else;
        None where it holds all records.
    """

    data: Buffer | Bytes = b""
    damage: str = ""
    offsets: NDArray[np.int64] | None = None


Content = TypeVar("Content", bound=ChunkContent)


class ChunkReader(ABC, Generic[Chunk, Content]):
    """Reads the messages of one channel; each format says how.

    Parameters
    ----------
    source
        The file.
    """

    def __init__(self, source: FileSource) -> None:
        self.source = source
        self.budget = DecompressionBudget(source.size)

    @abstractmethod
    def expected(self, chunk: Chunk) -> list[tuple[int, int]]:
        """Return begin and end of the bytes of the file that are read first for a chunk."""

    @abstractmethod
    def size_of(self, chunk: Chunk) -> int:
        """Return the bytes of the records of a chunk, as far as that is known; else 0."""

    @abstractmethod
    def is_mixed(self, chunk: Chunk) -> bool:
        """Return whether a chunk is known to hold other channels, and where its messages are."""

    @abstractmethod
    def whole(self, chunk: Chunk) -> Content:
        """Return the records of a chunk. Called in other threads."""

    @abstractmethod
    def selected(self, chunk: Chunk, whole: Content | None = None) -> Content | None:
        """Return copies of the wanted messages of a mixed chunk; None where all are needed.

        Called in other threads.

        Parameters
        ----------
        chunk
            The chunk.
        whole
            All of it; None to read a part of the file only, where that is quicker.
        """

    @abstractmethod
    def messages_at(self, content: Content, chunk: Chunk) -> MessageBlock | None:
        """Return the messages that were selected; None where they are others."""

    @abstractmethod
    def only_messages(self, data: Bytes, chunk: Chunk) -> tuple[MessageBlock, int] | None:
        """Return the messages of a chunk, and the id that they all have in it.

        None where anything else is between them, or they differ in length.
        """

    @abstractmethod
    def may_have(self, chunk: Chunk, log_ns: NDArray[np.int64], id_: int) -> bool:
        """Return whether an id is wanted, and a chunk has messages of it with these log times.

        That is, as many by the index, and within the range of log times that it states.
        """

    @abstractmethod
    def messages(self, content: Content, chunk: Chunk) -> MessageBlock | None:
        """Return the messages of a whole chunk, and note what is lost of them."""

    def blocks(self, chunks: Sequence[Chunk]) -> Iterator[MessageBlock]:
        """Yield the messages in some chunks, in their order.

        Chunks are read and decompressed ahead, in threads.
        """
        self._announce(chunks)
        bounds = [*(chunk.first_ns for chunk in chunks[1:]), LATEST]
        sized = ((chunk, self._size(chunk)) for chunk in chunks)
        with closing(load_ahead(sized, self._load)) as loaded:
            for (chunk, content), bound in zip(loaded, bounds, strict=False):
                block = self.located(content, chunk)
                if block:
                    yield replace(block, not_before_ns=bound)

    def _announce(self, chunks: Sequence[Chunk]) -> None:
        ranges = [each for chunk in chunks for each in self.expected(chunk)]
        self.source.expect([begin for begin, _ in ranges], [end for _, end in ranges])

    def _size(self, chunk: Chunk) -> int | None:
        """Return the bytes of the records of a chunk; None where only some of them are kept."""
        size = self.size_of(chunk)
        return None if size <= LARGE and self.is_mixed(chunk) else size or None

    def _load(self, chunk: Chunk) -> Content:
        """Return the wanted messages of a mixed chunk, or all of a chunk."""
        if not self.is_mixed(chunk):
            return self.whole(chunk)
        content = self.selected(chunk)
        if content is None:
            content = self.whole(chunk)
            if not content.damage:
                content = self.selected(chunk, content) or content
        return content

    def located(self, content: Content, chunk: Chunk) -> MessageBlock | None:
        """Return the messages of a loaded chunk."""
        if content.offsets is not None:
            block = self.messages_at(content, chunk)
            if block is not None:
                return block
            content = self.whole(chunk)
        if not content.damage:
            found = self.only_messages(np.frombuffer(content.data, np.uint8), chunk)
            if found and self.may_have(chunk, found[0].log_ns, found[1]):
                return found[0]
        return self.messages(content, chunk)
