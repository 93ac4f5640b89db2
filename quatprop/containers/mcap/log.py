"""MCAP files: profiles ros1, ros2 or any other, chunked or not, with or without summary."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from quatprop.containers.base import LATEST, Channel, MessageBlock, by_topic
from quatprop.containers.chunks import ChunkedLog
from quatprop.containers.compressed_messages import decompressed
from quatprop.containers.mcap.definitions import ids_by_channel
from quatprop.containers.mcap.index import build_index
from quatprop.containers.mcap.loading import McapReader, message_count
from quatprop.containers.mcap.redefinitions import DefinitionCheck
from quatprop.containers.mcap.regions import Region
from quatprop.containers.mcap.summary import MAGIC, read_provenance
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from pathlib import Path

    from quatprop.containers.file_source import FileSource


class McapLog(ChunkedLog[Region]):
    """An MCAP file; see :class:`quatprop.containers.base.MessageLog`.

    Parameters
    ----------
    log
        The file.
    is_zstd
        Whether messages are known to be compressed one by one; those in CDR are recognised.

    Attributes
    ----------
    index
        What it holds and where.

    Raises
    ------
    UnreadableLogError
        The file is missing or may not be read.
    UnsupportedLogError
        It is of another major version.
    DamagedLogError
        It is no MCAP file, or nothing of it can be read.
    """

    kind = "mcap"
    has_publish_time = True

    def __init__(self, log: Path | FileSource, *, is_zstd: bool = False) -> None:
        self._is_zstd = is_zstd
        super().__init__(log)

    def read_index(self) -> None:
        """Read what the file holds and where."""
        magic = self.source.read(0, len(MAGIC))
        if magic != MAGIC:
            self._refuse(magic)
        self.index = index = build_index(self.source)
        self._regions = index.regions
        self._ids = ids_by_channel(index)
        self._definitions = DefinitionCheck(index)
        self._unchecked: set[int] = set()
        self._stated = index.counts
        self.losses = index.losses
        if self.losses and not (self._ids or self._regions):
            first = self.losses[0]
            raise DamagedLogError(
                self.path, f"nothing of it can be read; {first.place}: {first.reason}"
            )

    def _refuse(self, magic: bytes) -> None:
        if len(magic) == len(MAGIC) and magic[:5] + magic[6:] == MAGIC[:5] + MAGIC[6:]:
            version = chr(magic[5])
            raise UnsupportedLogError(
                self.path, f"it is MCAP of version {version!r} and only version '0' is read"
            )
        raise DamagedLogError(
            self.path, "it does not begin as an MCAP file; check that the whole file was copied"
        )

    def channels(self) -> list[Channel]:
        """Return every channel, in order of topic, with or without messages."""
        return by_topic(replace(c, count=self._count(ids)) for c, ids in self._ids.items())

    def _count(self, ids: Sequence[int]) -> int | None:
        """Return how many messages the channels of these ids have; None if that is unknown."""
        if self._stated is not None:
            return sum(self._stated.get(id_, 0) for id_ in ids)
        return message_count(self._regions, ids)

    def chunks_of(self, channel: Channel) -> list[Region]:
        """Return the regions that may hold a channel, in order of time."""
        ids = set(self._ids.get(channel, []))
        regions = [r for r in self._regions if r.holds is None or not ids.isdisjoint(r.ids)]
        return sorted(regions, key=lambda region: (region.first_ns, region.start))

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, and compare their number with the file's."""
        count = yield from self.read(channel, self.chunks_of(channel))
        self._check_count(channel.topic, self._ids.get(channel, []), count)

    def read(
        self, channel: Channel, chunks: Sequence[Region]
    ) -> Generator[MessageBlock, None, int]:
        """Yield the messages of one channel in some regions; return how many are there or lost."""
        ids = self._ids.get(channel, [])
        reader = McapReader(self.source, self._definitions, channel.topic, ids, self._unchecked)
        count = 0
        for block in reader.blocks(chunks):
            count += len(block)
            self.unchecked_chunks = len(self._unchecked)
            self._remark_on_clamped(block)
            whole, lost = decompressed(block, channel.encoding, is_known=self._is_zstd)
            if lost:
                place, reason = f"topic {quoted(channel.topic)}", "their zstd data is damaged"
                self.losses.note(place, reason, lost, int(block.log_ns[0]))
            if len(whole):
                yield whole
        return count + reader.lost

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add definitions that channels lack."""
        ids_of: dict[Channel, list[int]] = {}
        for channel, ids in self._ids.items():
            ids_of.setdefault(completed(channel), []).extend(ids)
        self._ids = ids_of

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic, which a metadata record may carry, as JSON."""
        try:
            return read_provenance(self.source, self.index.metadata)
        except OSError as error:
            raise self.unreadable(error) from error

    def _remark_on_clamped(self, block: MessageBlock) -> None:
        remark = (
            "log times after the year 2262 do not fit int64 ns and are read as the last that does"
        )
        if block.log_ns.max() == LATEST and remark not in self.remarks:
            self.remarks = [*self.remarks, remark]

    def _check_count(self, topic: str, ids: Sequence[int], count: int) -> None:
        """Note a loss if the file states more messages than were read or lost."""
        if self._stated is None:
            return
        missing = sum(self._stated.get(id_, 0) for id_ in ids) - count
        if missing > 0:
            reason = f"it counts {missing} messages more than there are"
            self.losses.note("summary", reason, missing, topic)
