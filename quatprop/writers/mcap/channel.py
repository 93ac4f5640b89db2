"""An MCAP channel whose messages all have one size, written by the block.

The record of a message is a head of 31 bytes and the message. A chunk is one array that is filled a
column at a time, and its message index is two columns: the mcap package would take a call for each
message.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode

from quatprop.stores.checksum import crc32
from quatprop.writers.base import block_slices

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from quatprop.arrays import Int64, Records


CHUNK_BYTES = 1 << 20
"""About how large a chunk is before it is compressed."""

INDEX_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])
"""One message in a message index."""

_RECORD_HEAD_BYTES = 9
_ZSTD_LEVEL = -3
"""Attitudes are mostly noise to a compressor: level 1 would save 3 % for half again the time."""

COMPRESSIONS: Mapping[str, Callable[[bytes], bytes]] = {
    "none": lambda data: data,
    "lz4": lz4.frame.compress,
    "zstd": lambda data: zstandard.ZstdCompressor(_ZSTD_LEVEL).compress(data),
}
"""What a chunk can be compressed with."""


@dataclass(frozen=True, slots=True)
class McapChunk:
    """A chunk as it is written.

    `compression`: a key of :data:`COMPRESSIONS`
    `first`, `last`: its earliest and latest log time, ns
    `size`, `crc`: bytes and checksum of the records before compression
    `data`: the compressed records
    `indexes`: the message index of each channel, by id
    """

    compression: str
    first: int
    last: int
    size: int
    crc: int
    data: bytes
    indexes: Mapping[int, Records]


def compressed_chunk(compression: str, records: bytes, indexes: Mapping[int, Records]) -> McapChunk:
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


class MessageChannel:
    """A channel whose messages all have one size; made by McapFile.add_channel.

    `submit`: takes the records of a full chunk and their index by the channel's id
    `id_`: the channel's id
    `chunk_bytes`: About how large a chunk is before it is compressed
    """

    def __init__(self, submit: Callable[..., None], id_: int, chunk_bytes: int) -> None:
        self._submit = submit
        self._id = id_
        self._chunk_bytes = chunk_bytes
        self._written = 0
        self._rows: Records | None = None
        self._index = np.zeros(0, INDEX_ENTRY)
        self._filled = 0

    def write(self, log_ns: Int64, messages: Records) -> None:
        """Append messages.

        Parameters
        ----------
        log_ns
            When each was logged and published, shape ``(N,)``, ns, not before 1970.
        messages
            Shape ``(N,)``, always of the same item size.
        """
        if self._rows is None:
            self._rows = _empty_rows(self._id, messages.itemsize, self._chunk_bytes)
            self._index = np.zeros(len(self._rows), INDEX_ENTRY)
            self._index["offset"] = np.arange(len(self._rows)) * self._rows.itemsize
        data = messages.view(self._rows.dtype["data"])
        for source, place in block_slices(len(data), self._filled, len(self._rows)):
            rows = self._rows[place]
            rows["sequence"] = np.arange(self._written, self._written + len(rows), dtype=np.uint64)
            rows["log"] = rows["publish"] = self._index["log"][place] = log_ns[source]
            rows["data"] = data[source]
            self._written += len(rows)
            self._filled = place.stop
            if self._filled == len(self._rows):
                self.flush()

    def flush(self) -> None:
        """Write the messages that do not fill a chunk."""
        if self._rows is None or not self._filled:
            return
        records = self._rows[: self._filled].tobytes()
        self._submit(records, {self._id: self._index[: self._filled].copy()})
        self._filled = 0


def _empty_rows(channel: int, size: int, chunk_bytes: int) -> Records:
    """Return the records of a chunk of messages, without times and data."""
    dtype = np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("sequence", "<u4"),
            ("log", "<u8"),
            ("publish", "<u8"),
            ("data", f"V{size}"),
        ]
    )
    rows = np.zeros(max(1, chunk_bytes // dtype.itemsize), dtype)
    rows["opcode"] = Opcode.MESSAGE
    rows["length"] = dtype.itemsize - _RECORD_HEAD_BYTES
    rows["channel"] = channel
    return rows
