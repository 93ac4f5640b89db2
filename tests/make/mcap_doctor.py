"""What `mcap doctor` would look at, from the specification: a walk over every byte of a file."""

import struct
import zlib
from collections import Counter
from io import BytesIO

from make.mcap import MAGIC
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream

KINDS = {
    Opcode.HEADER: records.Header,
    Opcode.FOOTER: records.Footer,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK: records.Chunk,
    Opcode.MESSAGE_INDEX: records.MessageIndex,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.STATISTICS: records.Statistics,
    Opcode.METADATA: records.Metadata,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset,
    Opcode.DATA_END: records.DataEnd,
}
SUMMARY = [
    Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
]  # fmt: skip


def walk(data, begin, end):
    """Return place, opcode and content of each record between two places, which it fills."""
    found = []
    while begin < end:
        opcode, length = struct.unpack_from("<BQ", data, begin)
        stop = begin + 9 + length
        assert stop <= end, f"record at {begin} leads beyond {end}"
        found.append((begin, opcode, bytes(data[begin + 9 : stop])))
        begin = stop
    assert begin == end
    return found


def read(opcode, content):
    """Return a record as the library reads it."""
    if opcode == Opcode.MESSAGE:
        return records.Message.read(ReadDataStream(BytesIO(content)), len(content))
    return KINDS[opcode].read(ReadDataStream(BytesIO(content)))


class Doctor:
    """Looks through a file."""

    def __init__(self, path):
        self.data = path.read_bytes()
        self.schemas, self.channels = {}, {}
        self.chunks, self.attachments, self.metadata = [], [], []
        self.counts, self.times = Counter(), []
        self.starts = []

    def examine(self):
        """Assert that everything in the file is as it should be, and return oneself."""
        data = self.data
        assert data.startswith(MAGIC)
        assert data.endswith(MAGIC)
        footer_at = len(data) - len(MAGIC) - 29
        footer = read(*walk(data, footer_at, len(data) - len(MAGIC))[0][1:])
        end = self._data_section(footer.summary_start)
        self._summary(footer, footer_at)
        assert end == footer.summary_start
        return self

    def _data_section(self, summary_start):
        every = walk(self.data, len(MAGIC), summary_start)
        assert every[0][1] == Opcode.HEADER
        assert [opcode for _, opcode, _ in every].count(Opcode.HEADER) == 1
        place, opcode, content = every[-1]
        assert opcode == Opcode.DATA_END
        assert read(opcode, content).data_section_crc == zlib.crc32(self.data[:place])
        expected = None
        for place, opcode, content in every[1:-1]:
            assert opcode in {*KINDS, Opcode.MESSAGE} or opcode >= 0x80
            if opcode == Opcode.MESSAGE_INDEX:
                self._message_index(place, content, expected)
                continue
            assert not expected, "a chunk has messages that no index tells"
            expected = None
            if opcode == Opcode.CHUNK:
                expected = self._chunk(place, content)
            elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                self._define(opcode, content)
            elif opcode == Opcode.MESSAGE:
                self._message(content)
            elif opcode == Opcode.ATTACHMENT:
                attachment = read(opcode, content)
                assert zlib.crc32(content[:-4]) == int.from_bytes(content[-4:], "little")
                self.attachments.append(
                    records.AttachmentIndex(
                        place, len(content) + 9, attachment.log_time, attachment.create_time,
                        len(attachment.data), attachment.name, attachment.media_type,
                    )
                )  # fmt: skip
            elif opcode == Opcode.METADATA:
                name = read(opcode, content).name
                self.metadata.append(records.MetadataIndex(place, len(content) + 9, name))
        assert not expected, "a chunk has messages that no index tells"
        return every[-1][0] + 9 + 4

    def _define(self, opcode, content):
        record = read(opcode, content)
        known = self.schemas if opcode == Opcode.SCHEMA else self.channels
        assert known.setdefault(record.id, record) == record
        if opcode == Opcode.SCHEMA:
            assert record.id != 0
        else:
            assert record.schema_id in {0, *self.schemas}

    def _message(self, content):
        message = read(Opcode.MESSAGE, content)
        assert message.channel_id in self.channels
        self.counts[message.channel_id] += 1
        self.times.append(message.log_time)
        return message

    def _chunk(self, place, content):
        """Look into a chunk; return what its message indexes must be."""
        chunk = read(Opcode.CHUNK, content)
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        inside = stream.read(size)
        assert len(inside) == chunk.uncompressed_size == size
        assert chunk.uncompressed_crc in {0, zlib.crc32(inside)}
        index = {}
        for at, opcode, part in walk(inside, 0, len(inside)):
            assert opcode in {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}
            if opcode == Opcode.MESSAGE:
                message = self._message(part)
                index.setdefault(message.channel_id, []).append((message.log_time, at))
            else:
                self._define(opcode, part)
        times = [time for entries in index.values() for time, _ in entries]
        assert chunk.message_start_time == min(times, default=0)
        assert chunk.message_end_time == max(times, default=0)
        if times:
            self.starts.append(min(times))
        self.chunks.append(
            records.ChunkIndex(
                chunk_length=len(content) + 9,
                chunk_start_offset=place,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        return index

    def _message_index(self, place, content, expected):
        index = read(Opcode.MESSAGE_INDEX, content)
        assert expected is not None, "a message index without a chunk"
        entries = expected.pop(index.channel_id, [])
        assert [tuple(entry) for entry in index.records] == sorted(entries, key=lambda e: e[0])
        chunk = self.chunks[-1]
        chunk.message_index_offsets[index.channel_id] = place
        chunk.message_index_length += len(content) + 9

    def _summary(self, footer, footer_at):
        data = self.data
        start, offsets_start = footer.summary_start, footer.summary_offset_start
        groups = {}
        for place, opcode, content in walk(data, start, offsets_start):
            groups.setdefault(opcode, []).append((place, len(content) + 9, read(opcode, content)))
        assert list(groups) == [opcode for opcode in SUMMARY if opcode in groups]
        told = {opcode: [record for _, _, record in found] for opcode, found in groups.items()}
        assert {s.id: s for s in told.get(Opcode.SCHEMA, [])} == self.schemas
        assert {c.id: c for c in told.get(Opcode.CHANNEL, [])} == self.channels
        assert told.get(Opcode.CHUNK_INDEX, []) == self.chunks
        assert told.get(Opcode.ATTACHMENT_INDEX, []) == self.attachments
        assert told.get(Opcode.METADATA_INDEX, []) == self.metadata
        (statistics,) = told[Opcode.STATISTICS]
        assert statistics == records.Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks),
            message_count=self.counts.total(),
            message_end_time=max(self.times, default=0),
            message_start_time=min(self.times, default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )
        offsets = [read(opcode, part) for _, opcode, part in walk(data, offsets_start, footer_at)]
        assert offsets == [
            records.SummaryOffset(
                group_opcode=opcode,
                group_start=found[0][0],
                group_length=sum(length for _, length, _ in found),
            )
            for opcode, found in groups.items()
        ]
        covered = data[start : footer_at + 9 + 16]
        assert footer.summary_crc == zlib.crc32(covered)


def examine(path):
    """Assert that an MCAP file is as it should be; return what was found in it."""
    return Doctor(path).examine()
