"""Chunks of MCAP files: compressed records, and the message index of each channel.

The record of a message has a head of 31 bytes. A chunk of messages of one size is one array that is
filled a column at a time, and its message index is two columns: the mcap package would need a call
for each message.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode

from quatprop.stores.checksum import crc32
from quatprop.writers.base import empty_records

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from quatprop.arrays import Records
    from quatprop.stores.compression import Buffer


CHUNK_BYTES = 1 << 20
"""Approximate bytes of a chunk before compression."""

INDEX_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])
"""One message in a message index."""

_RECORD_HEAD_BYTES = 9
_ZSTD_LEVEL = -3
"""Attitudes hardly compress: level 1 would save another 3 % for half again the time."""

COMPRESSIONS: Mapping[str, Callable[[Buffer], Buffer]] = {
    "none": lambda data: data,
    "lz4": lz4.frame.compress,
    "zstd": lambda data: zstandard.ZstdCompressor(_ZSTD_LEVEL).compress(data),
}
"""Compressions of chunks."""


@dataclass(frozen=True, slots=True)
class McapChunk:
    """A chunk to be written.

    `compression`: a key of :data:`COMPRESSIONS`
    `first`, `last`: earliest and latest log time, ns
    `size`, `crc`: bytes and checksum of the records before compression
    `indexes`: the message index of each channel, by id
    """

    compression: str
    first: int
    last: int
    size: int
    crc: int
    data: Buffer
    indexes: Mapping[int, Records]


def compressed_chunk(
    compression: str, records: Buffer, indexes: Mapping[int, Records]
) -> McapChunk:
    """Return a chunk of records."""
    return McapChunk(
        compression=compression,
        first=min(int(index["log"].min()) for index in indexes.values()),
        last=max(int(index["log"].max()) for index in indexes.values()),
        size=len(records),
        crc=crc32(records),
        data=COMPRESSIONS[compression](records),
        indexes=indexes,
    )


def chunk_of_messages(compression: str, messages: Records) -> McapChunk:
    """Return a chunk of messages of one channel, with the fields of :func:`empty_messages`."""
    index = np.empty(len(messages), INDEX_ENTRY)
    index["log"] = messages["log"]
    index["offset"] = np.arange(len(messages)) * messages.itemsize
    records = messages.view(np.uint8).data
    return compressed_chunk(compression, records, {int(messages["channel"][0]): index})


def empty_messages(channel: int, chunk_bytes: int, size: int) -> Records:
    """Return records of messages of `size` bytes for one chunk, without times and data."""
    head = {
        "opcode": "u1",
        "length": "<u8",
        "channel": "<u2",
        "sequence": "<u4",
        "log": "<u8",
        "publish": "<u8",
    }
    rows = empty_records(head, size, chunk_bytes)
    rows["opcode"] = Opcode.MESSAGE
    rows["length"] = rows.itemsize - _RECORD_HEAD_BYTES
    rows["channel"] = channel
    return rows
