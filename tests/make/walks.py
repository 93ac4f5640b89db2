"""Independent walks of intact logs: where parts end, and how many samples come before there."""

import io
import sqlite3
from contextlib import closing

import numpy as np
import pyarrow as pa
from make import ulog
from make.formats import SAMPLES
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.rosbag1 import Reader as BagReader


def part_ends(path):
    """Return where parts of a log end and how many samples they end with, by others' count."""
    walk = WALKS.get(path.suffix)
    return walk(path) if walk else []


def _line_ends(path):
    lines = path.read_bytes().splitlines(keepends=True)
    ends = np.cumsum([len(line) for line in lines])
    return list(zip(ends.tolist(), range(SAMPLES - len(lines) + 1, SAMPLES + 1), strict=True))


def _record_ends(path):
    parts = []
    file = io.BytesIO(path.read_bytes())
    for record in StreamReader(file, emit_chunks=True).records:
        inside = breakup_chunk(record) if isinstance(record, Chunk) else [record]
        parts.append((file.tell(), sum(isinstance(one, Message) for one in inside)))
    counts = np.cumsum([count for _, count in parts])
    return [(end, int(count)) for (end, _), count in zip(parts, counts, strict=True)]


def _chunk_ends(path):
    with BagReader(path) as reader:
        chunks = sorted(reader.chunk_infos, key=lambda chunk: chunk.pos)
    counts = np.cumsum([sum(chunk.connection_counts.values()) for chunk in chunks])
    return list(zip([chunk.pos for chunk in chunks[1:]], counts[:-1].tolist(), strict=True))


def _ulog_ends(path):
    data, count, found = path.read_bytes(), 0, []
    for kind, begin, end in ulog.walk(data):
        count += kind == b"D" and data[begin : begin + 2] == b"\x01\0"
        found.append((end, count))
    return found


def _batch_ends(path):
    with path.open("rb") as file:
        file.seek(8)
        messages, count, found = pa.ipc.MessageReader.open_stream(file), 0, []
        schema = pa.ipc.read_schema(messages.read_next_message())
        while count < SAMPLES:
            count += pa.ipc.read_record_batch(messages.read_next_message(), schema).num_rows
            found.append((file.tell(), count))
    return found


def _page_ends(path):
    content = path.read_bytes()
    size = int.from_bytes(content[16:18], "big")
    with closing(sqlite3.connect(path)) as database:
        rows = database.execute("SELECT data FROM messages ORDER BY timestamp").fetchall()
    ends = [(content.index(data) // size + 1) * size for (data,) in rows]
    # A message is among the first that are left where those before it are, too.
    ends = np.maximum.accumulate(ends)
    return list(zip(ends.tolist(), range(1, len(ends) + 1), strict=True))


WALKS = {
    ".csv": _line_ends,
    ".jsonl": _line_ends,
    ".mcap": _record_ends,
    ".bag": _chunk_ends,
    ".ulg": _ulog_ends,
    ".feather": _batch_ends,
    ".db3": _page_ends,
}
"""By suffix: lines, records, chunks, batches or pages. Other logs that are cut are refused."""
