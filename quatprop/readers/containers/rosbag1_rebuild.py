"""Rebuild the index of a ROS 1 bag by walking its records, resuming after damage."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.readers.containers.rosbag1_index import (
    MAGIC,
    OP_BAG_HEADER,
    OP_CHUNK,
    OP_CHUNK_INFO,
    OP_CONNECTION,
    OP_INDEX_DATA,
    OP_MESSAGE,
    BagChunk,
    BagIndex,
    Record,
    RecordFile,
    chunk_of_info,
    index_data,
    read_chunk,
)
from quatprop.readers.containers.rosbag1_walk import (
    CHUNKS,
    ENDS,
    RECORDS,
    is_chunk,
    next_record,
    surviving_records,
)
from quatprop.stores.compression import UnreadableDataError

_LOOSE_SIZE = 1 << 20
"""Maximum bytes of a run of messages outside chunks."""


def rebuild_index(file: RecordFile, index: BagIndex) -> None:
    """Complete an index by walking the records behind its end, resuming after damage."""
    at, known = index.end, len(index.chunks)
    while at < file.size:
        try:
            record = file.record(at)
            _add(file, index, record)
        except UnreadableDataError as error:
            at = _resume(file, index, at, str(error))
        else:
            at = record.end
    index.end = file.size
    chunks = index.chunks[known:]
    infos = {info.start: info for info in index.infos}
    owner: BagChunk | None = None
    missing = Counter[int]()
    for chunk, after in zip(chunks, [*chunks, None][1:], strict=True):
        info = infos.pop(chunk.start, None)
        if not chunk.is_unchunked:
            owner, missing = chunk, Counter()
        chunk.is_checked, chunk.is_proved = True, info is not None and info.counts == chunk.counts
        # The index data of the last chunk may be incomplete, and that of others damaged.
        if (
            (info is not None and not chunk.is_proved)
            or after is None
            or after.is_unchunked
            or after.id_offset != chunk.id_offset
            or chunk.is_unchunked
            or not chunk.counts
            or not chunk.counts.keys() <= chunk.local_ids(index.connections.keys())
        ):
            index.id_offset = chunk.id_offset
            stated = Counter(chunk.counts if info is None else info.counts)
            found = _read_inside(file, index, chunk, stated)
            if chunk is owner:
                missing = Counter(chunk.counts) - found
            elif owner is not None:
                # Messages outside of a damaged chunk are not missing in it.
                owner.counts = dict(Counter(owner.counts) - (missing & found))
                missing -= found
    _add_missing(index, chunks, sorted(infos.values(), key=lambda info: info.start))


def _add_missing(index: BagIndex, chunks: list[BagChunk], infos: list[BagChunk]) -> None:
    """Add chunks that are not at the offset in their chunk infos, with the missing counts."""
    begins = {info.start for info in index.infos} - {info.start for info in infos}
    ends = [*sorted(begins), index.end]
    others = [chunk for chunk in chunks if chunk.start not in begins]
    for info in infos:
        end = next((end for end in ends if end > info.start), info.start)
        # Its offset may be wrong, or a part of it was found there outside any chunk.
        parts = [each for each in others if each.counts == info.counts][:1] or [
            each for each in others if info.start <= each.start < end
        ]
        found: Counter[int] = Counter()
        for part in parts:
            found.update(part.counts)
            others.remove(part)
        info.counts = dict(Counter(info.counts) - found)
        if info.counts:
            info.is_checked = info.is_proved = True
            info.is_missing = bool(parts)
            index.chunks.append(info)


def _resume(file: RecordFile, index: BagIndex, at: int, reason: str) -> int:
    """Record that no record can be read at `at`; return where to resume."""
    if file.tried(at, len(MAGIC)) == MAGIC:
        index.origin = at
        return at + len(MAGIC)  # the header of another bag follows
    last = index.chunks[-1] if index.chunks else None
    resumed_at = None
    if last is not None and not last.is_unchunked and last.end == at and not last.counts:
        # The length of the previous chunk may be wrong, or bytes were inserted into it or lost.
        resumed_at = next_record(file, last.start + 1, file.size, ENDS)
        is_end = resumed_at is not None and file.record(resumed_at).op == OP_INDEX_DATA
        if resumed_at is not None and (is_end or resumed_at < at):
            last.record = replace(file.record(last.start), end=resumed_at)
            last.end, last.is_resized = resumed_at, True
            reason = f"{reason}; the chunk before it ends at byte {resumed_at}"
            index.losses.note(f"byte {at}", reason)
            return resumed_at
        resumed_at = None
    if resumed_at is None:
        resumed_at = next_record(file, at + 1, file.size, RECORDS)
    if resumed_at is None:
        index.losses.note(f"byte {at}", f"{reason}; what follows is not read")
        return file.size
    size = max(0, resumed_at - at)
    index.losses.note(f"byte {at}", f"{reason}; {size} bytes are skipped")
    return resumed_at


def _is_damaged_chunk(file: RecordFile, record: Record) -> bool:
    """Return whether a chunk's header is inconsistent, or its end is behind another chunk."""
    if not is_chunk(record):
        return True
    beyond = record.end > file.size
    return beyond and next_record(file, record.start + 1, file.size, CHUNKS) is not None


def _add(file: RecordFile, index: BagIndex, record: Record) -> None:
    """Add one record to the index."""
    if record.op == OP_CHUNK:
        if _is_damaged_chunk(file, record):
            raise UnreadableDataError("its chunk is damaged")
        end = min(record.end, file.size)
        index.chunks.append(BagChunk(record.start, end, id_offset=index.id_offset))
    elif record.op == OP_MESSAGE:
        last = index.chunks[-1] if index.chunks else None
        if (
            last
            and last.is_unchunked
            and last.end == record.start
            and record.start - last.start < _LOOSE_SIZE
        ):
            last.end = min(record.end, file.size)
        else:
            end = min(record.end, file.size)
            chunk = BagChunk(record.start, end, is_unchunked=True, id_offset=index.id_offset)
            index.chunks.append(chunk)
    elif record.op == OP_BAG_HEADER:
        index.begin_bag(record.start - len(MAGIC))
    elif record.op not in RECORDS:
        raise UnreadableDataError("its kind is unknown")
    elif record.end > file.size:
        raise UnreadableDataError("its record is cut off")
    elif record.op == OP_CONNECTION:
        index.add_connection(record, file.at(record.data, record.end - record.data))
    elif record.op == OP_CHUNK_INFO:
        info = chunk_of_info(record, file.at(record.data, record.end - record.data))
        info.start += index.origin
        info.end, info.id_offset = info.start, index.id_offset
        index.infos.append(info)
    elif record.op == OP_INDEX_DATA and index.chunks:
        _add_times(index.chunks, file.at(record.start, record.end - record.start), record.end)


def _add_times(chunks: list[BagChunk], record: bytes, end: int) -> None:
    """Add counts and the earliest time from the index data of one connection.

    Messages outside of chunks have none: behind them it is that of the chunk before.
    """
    owner = next((chunk for chunk in reversed(chunks) if not chunk.is_unchunked), None)
    if owner is None:
        return
    is_behind = owner is chunks[-1]
    owner.end = end if is_behind else owner.end
    for conn, entries in index_data(record)[0].items():
        if len(entries) and (is_behind or conn not in owner.counts):
            sec, nsec = (entries[name].astype(np.int64) for name in ("sec", "nsec"))
            earliest = int((sec * NS_PER_S + nsec).min())
            owner.first_ns = min(owner.first_ns, earliest) if owner.counts else earliest
            owner.counts[conn] = owner.counts.get(conn, 0) + len(entries)


def _read_inside(
    file: RecordFile, index: BagIndex, chunk: BagChunk, stated: Counter[int]
) -> Counter[int]:
    """Walk the records of a chunk for its connections, counts and earliest time; return the counts.

    `stated`: counts by its chunk info, if there is one. A damaged chunk should have the messages
        that it or the index data count; an intact one only those of both, as one may be wrong
    """
    indexed, chunk.counts = Counter(chunk.counts), dict(stated)
    try:
        loaded = read_chunk(file, chunk, chunk.record)
    except UnreadableDataError as error:
        index.losses.note(chunk.place, str(error))
        return Counter()
    times: list[int] = []
    counts: Counter[int] = Counter()
    records, damage = surviving_records(loaded)
    for record in records:
        if record.op == OP_CONNECTION:
            index.add_connection(record, loaded.data[record.data : record.end].tobytes())
        else:
            counts[record.number(b"conn")] += 1
            times.append(record.time(b"time"))
    if loaded.damage or damage:
        index.losses.note(chunk.place, loaded.damage or damage)
        stated |= indexed
    else:
        stated &= indexed
    chunk.counts, chunk.first_ns = dict(counts | stated), min(times, default=chunk.first_ns)
    chunk.is_proved = True
    return counts
