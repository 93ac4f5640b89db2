"""The contents of an MCAP file being written, and their summary section."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from quatprop.stores.checksum import crc32

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mcap.records import McapRecord

_CRC_BYTES = 4


@dataclass(slots=True)
class McapContents:
    """The records that the summary of a file lists."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)

    def summary(self, start: int) -> bytes:
        """Return the summary section and the footer."""
        parts: list[bytes] = []
        offsets: list[McapRecord] = []
        place = start
        for opcode, records in self._groups():
            data = encoded(records)
            if data:
                parts.append(data)
                offsets.append(SummaryOffset(opcode, place, len(data)))
                place += len(data)
        # The CRC covers the section, and the footer up to the CRC.
        section = b"".join([*parts, encoded(offsets)])
        footer = encoded([Footer(start, place, 0)])
        crc = crc32(footer[:-_CRC_BYTES], crc32(section))
        return section + footer[:-_CRC_BYTES] + crc.to_bytes(_CRC_BYTES, "little")

    def _groups(self) -> Iterator[tuple[Opcode, Iterable[McapRecord]]]:
        yield Opcode.SCHEMA, self.schemas.values()
        yield Opcode.CHANNEL, self.channels.values()
        yield Opcode.STATISTICS, [self._statistics()]
        yield Opcode.CHUNK_INDEX, self.chunks
        yield Opcode.ATTACHMENT_INDEX, self.attachments
        yield Opcode.METADATA_INDEX, self.metadata

    def _statistics(self) -> Statistics:
        # The times of a chunk without messages are zero and meaningless.
        filled = [chunk for chunk in self.chunks if chunk.message_index_offsets]
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts={k: self.counts[k] for k in sorted(self.counts)},
            chunk_count=len(self.chunks),
            message_count=self.counts.total(),
            message_start_time=min((chunk.message_start_time for chunk in filled), default=0),
            message_end_time=max((chunk.message_end_time for chunk in filled), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


def encoded(records: Iterable[McapRecord]) -> bytes:
    """Return the bytes of records, concatenated."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
