"""Read the messages of a channel from the parts of a log, such as chunks, for all formats."""

from __future__ import annotations

from collections.abc import Hashable
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol, TypeAlias, TypeVar

import numpy as np

from quatprop.base.errors import UnreadableLogError, os_reason
from quatprop.base.threads import prefetch
from quatprop.base.times import LATEST
from quatprop.readers.messages.blocks import MessageBlock
from quatprop.readers.tables.model import TimeRange
from quatprop.stores.compression import UnreadableDataError, decompress
from quatprop.stores.file_source import SHARE

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
    from pathlib import Path

    from quatprop.stores.file_source import FileSource


@contextmanager
def system_errors(path: Path | str) -> Iterator[None]:
    """Name the log in errors of the operating system."""
    try:
        yield
    except OSError as error:
        raise UnreadableLogError(path, os_reason(error)) from error


@contextmanager
def opening(source: FileSource) -> Iterator[None]:
    """Close a file that cannot be opened as a log, and name it in errors of the system."""
    try:
        with system_errors(source.path):
            yield
    except BaseException:
        source.close()
        raise


class TimedPart(Protocol):
    """A part of a log, such as a chunk; times in ns."""

    @property
    def first_ns(self) -> int:
        """Return the earliest log time."""

    @property
    def last_ns(self) -> int | None:
        """Return the latest log time; None if unknown."""


Part = TypeVar("Part", bound=TimedPart)
Part_contra = TypeVar("Part_contra", bound=TimedPart, contravariant=True)
Content = TypeVar("Content")
Item = TypeVar("Item")

Lost: TypeAlias = tuple[str, str, int | None, Hashable]
"""Place, reason, number of messages and part of a loss, as :meth:`.Losses.note` takes them."""

Loaded: TypeAlias = tuple[MessageBlock | None, list[Lost]]
"""The messages in a part, and what of it is lost."""

GROUP = 1 << 20
"""Bytes of parts that are loaded together: they stay in the processor's cache until decoded."""

FIRST = 1 << 16
"""Bytes of the first group, small for callers that read only the beginning; each doubles."""

LARGE = 1 << 26
"""Parts of more bytes are not loaded ahead of their use."""


class PartReader(Protocol[Part_contra]):
    """Reads the messages of one channel, for :func:`read_parts`."""

    def is_mixed(self, part: Part_contra) -> bool:
        """Return whether a part is known to have messages of other channels, too."""

    def expected(self, part: Part_contra) -> list[tuple[int, int]]:
        """Return the byte ranges of the file that are read first for a part."""

    def size_of(self, part: Part_contra) -> int:
        """Return the bytes of the decompressed records of a part; 0 if unknown."""

    def load(self, part: Part_contra) -> Loaded:
        """Return the messages in a part, and what of it is lost. Called in other threads."""

    def note(self, place: str, reason: str, messages: int | None, part: Hashable) -> None:
        """Record a loss; see :meth:`.Losses.note`."""


def read_parts(
    source: FileSource, parts: Sequence[Part], reader: PartReader[Part]
) -> Iterator[MessageBlock]:
    """Yield the messages of one channel in some parts of a file, in the order of the parts.

    Parts are read and decompressed ahead, in threads; none is kept, so memory use does not grow
    with the file.
    """
    ranges = [each for part in parts for each in reader.expected(part)]
    source.expect([begin for begin, _ in ranges], [end for _, end in ranges])
    bounds = [*(part.first_ns for part in parts[1:]), LATEST]

    def share_of(part: Part) -> int:
        """Return the bytes by which a part fills a group: of a mixed part little is decoded."""
        size = reader.size_of(part)
        return size // SHARE if size <= LARGE and reader.is_mixed(part) else size

    def load(part: Part) -> Loaded:
        """Return copies of the messages of a mixed part, whose memory is then freed."""
        block, lost = reader.load(part)
        return block.compacted() if block and reader.is_mixed(part) else block, lost

    sized = ((part, share_of(part)) for part in parts)
    with closing(load_ahead(sized, load)) as loaded:
        for (block, lost), bound in zip(loaded, bounds, strict=False):
            for loss in lost:
                reader.note(*loss)
            if block:
                yield replace(block, watermark_ns=bound)


def span_of(parts: Sequence[TimedPart]) -> TimeRange | None:
    """Return the range of log times of parts in order of time; None if one is unknown."""
    last = [part.last_ns for part in parts if part.last_ns is not None]
    if not parts or len(last) < len(parts):
        return None
    return TimeRange(parts[0].first_ns, max(last))


def parts_within(parts: Sequence[Part], within: TimeRange | None) -> Sequence[Part]:
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


WINDOW, NARROW = 1 << 22, 1 << 12
"""Bytes searched at a time: at most, and at first, since the next record is often near."""


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
    begin, stop, behind = within
    size = NARROW
    while begin < stop:
        for place in candidates(read(begin, min(size, stop - begin) + behind)):
            record = accepted(begin + place)
            tries -= 1
            if record is not None or tries == 0:
                return record
        begin += size
        size = min(2 * size, WINDOW)
    return None
