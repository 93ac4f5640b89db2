"""The checks of `mcap doctor`, from the specification: a walk over every byte of a file."""

import struct
import zlib
from collections import Counter
from io import BytesIO

from make.mcap import MAGIC
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, MetadataIndex, Statistics, SummaryOffset
from mcap.stream_reader import get_chunk_data_stream

KINDS = {code: getattr(records, code.name.title().replace("_", "")) for code in Opcode}
SUMMARY = [
    Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
]  # fmt: skip


def walk(data, begin, end):
    """Yield place, opcode and content of each record between two places, which they fill."""
    while begin < end:
        opcode, length = struct.unpack_from("<BQ", data, begin)
        stop = begin + 9 + length
        assert stop <= end, f"record at {begin} leads beyond {end}"
        yield begin, opcode, bytes(data[begin + 9 : stop])
        begin = stop


def read(opcode, content):
    """Return a record as the library reads it."""
    length = [len(content)] * (opcode == Opcode.MESSAGE)
    return KINDS[opcode].read(ReadDataStream(BytesIO(content)), *length)


class Doctor:
    """The findings in a file."""

    def __init__(self, path):
        data = self.data = path.read_bytes()
        self.known = {Opcode.SCHEMA: {}, Opcode.CHANNEL: {}}
        self.channels = self.known[Opcode.CHANNEL]
        self.chunks, self.attachments, self.metadata = [], [], []
        self.counts, self.times, self.starts = Counter(), [], []
        assert data.startswith(MAGIC)
        assert data.endswith(MAGIC)
        footer_at = len(data) - len(MAGIC) - 29
        ((_, *found),) = walk(data, footer_at, len(data) - len(MAGIC))
        footer = read(*found)
        self._data_section([*walk(data, len(MAGIC), footer.summary_start)])
        self._summary(footer, footer_at)

    def _data_section(self, every):
        assert [opcode for _, opcode, _ in every].count(Opcode.HEADER) == 1
        assert every[0][1] == Opcode.HEADER
        place, opcode, content = every[-1]
        assert opcode == Opcode.DATA_END
        assert read(opcode, content).data_section_crc == zlib.crc32(self.data[:place])
        expected = None
        for place, opcode, content in every[1:-1]:
            assert opcode in KINDS or opcode >= 0x80
            if opcode == Opcode.MESSAGE_INDEX:
                self._message_index(place, content, expected)
                continue
            assert not expected, "a chunk has messages that no index tells"
            size, expected = len(content) + 9, None
            if opcode == Opcode.CHUNK:
                expected = self._chunk(place, content)
            elif opcode in self.known:
                self._define(opcode, content)
            elif opcode == Opcode.MESSAGE:
                self._message(content)
            elif opcode == Opcode.ATTACHMENT:
                one = read(opcode, content)
                assert zlib.crc32(content[:-4]) == int.from_bytes(content[-4:], "little")
                about = one.log_time, one.create_time, len(one.data), one.name, one.media_type
                self.attachments.append(AttachmentIndex(place, size, *about))
            elif opcode == Opcode.METADATA:
                self.metadata.append(MetadataIndex(place, size, read(opcode, content).name))
        assert not expected, "a chunk has messages that no index tells"

    def _define(self, opcode, content):
        record = read(opcode, content)
        assert self.known[opcode].setdefault(record.id, record) == record
        if opcode == Opcode.SCHEMA:
            assert record.id != 0
        else:
            assert record.schema_id in {0, *self.known[Opcode.SCHEMA]}

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
            if opcode == Opcode.MESSAGE:
                message = self._message(part)
                index.setdefault(message.channel_id, []).append((message.log_time, at))
            else:
                self._define(opcode, part)
        times = [time for entries in index.values() for time, _ in entries]
        span = chunk.message_start_time, chunk.message_end_time
        assert span == (min(times, default=0), max(times, default=0))
        self.starts += [min(times)] if times else []
        self.chunks.append(
            ChunkIndex(
                chunk_length=len(content) + 9, chunk_start_offset=place,
                compression=chunk.compression, compressed_size=len(chunk.data),
                message_start_time=span[0], message_end_time=span[1],
                message_index_length=0, message_index_offsets={},
                uncompressed_size=chunk.uncompressed_size,
            )
        )  # fmt: skip
        return index

    def _message_index(self, place, content, expected):
        index = read(Opcode.MESSAGE_INDEX, content)
        assert expected is not None, "a message index without a chunk"
        entries = expected.pop(index.channel_id, [])
        assert [tuple(entry) for entry in index.records] == sorted(entries, key=lambda e: e[0])
        self.chunks[-1].message_index_offsets[index.channel_id] = place
        self.chunks[-1].message_index_length += len(content) + 9

    def _summary(self, footer, footer_at):
        start, offsets_start = footer.summary_start, footer.summary_offset_start
        told, groups = {}, {}
        for place, opcode, content in walk(self.data, start, offsets_start):
            told.setdefault(opcode, []).append(read(opcode, content))
            begin, length = groups.get(opcode, (place, 0))
            groups[opcode] = begin, length + len(content) + 9
        assert list(told) == [opcode for opcode in SUMMARY if opcode in told]
        for opcode, known in self.known.items():
            assert {record.id: record for record in told.get(opcode, [])} == known
        assert told.get(Opcode.CHUNK_INDEX, []) == self.chunks
        assert told.get(Opcode.ATTACHMENT_INDEX, []) == self.attachments
        assert told.get(Opcode.METADATA_INDEX, []) == self.metadata
        assert told[Opcode.STATISTICS] == [
            Statistics(
                attachment_count=len(self.attachments), channel_count=len(self.channels),
                channel_message_counts=dict(self.counts), chunk_count=len(self.chunks),
                message_count=self.counts.total(), metadata_count=len(self.metadata),
                message_start_time=min(self.times, default=0),
                message_end_time=max(self.times, default=0),
                schema_count=len(self.known[Opcode.SCHEMA]),
            )
        ]  # fmt: skip
        offsets = [read(*found) for _, *found in walk(self.data, offsets_start, footer_at)]
        assert offsets == [SummaryOffset(code, *group) for code, group in groups.items()]
        assert footer.summary_crc == zlib.crc32(self.data[start : footer_at + 9 + 16])


def examine(path):
    """Assert that an MCAP file is as it should be; return what was found in it."""
    return Doctor(path)
