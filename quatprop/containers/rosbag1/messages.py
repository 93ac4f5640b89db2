"""Locate the messages of connections in a decompressed chunk by its index data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.rosbag1.records import OP_MESSAGE, fields_of, header_end_of
from quatprop.messages.blocks import MessageBlock
from quatprop.stores.compression import UnreadableDataError
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray


def indexed_messages(
    data: NDArray[np.uint8], offsets: NDArray[np.int64], connections: Iterable[int]
) -> MessageBlock | None:
    """Return the indexed messages of some connections; None if the index is wrong.

    All headers are compared with the first to detect a wrong index.

    `data`: the decompressed chunk, shape ``(B,)``
    `offsets`: offsets of their records by the index, shape ``(N,)``, ascending
    """
    if len(offsets) == 0:
        return None
    first, last = int(offsets[0]), int(offsets[-1])
    layout = _message_layout(data.data, first)
    if layout is None or last + layout.itemsize > len(data):
        return None
    size, count = layout.itemsize, len(offsets)
    stride = size + int.from_bytes(data[first + size - 4 : first + size].tobytes(), "little")
    if (offsets[1:] - offsets[:-1] == stride).all():
        every = np.ndarray((count,), f"V{size}", data, first, (stride,)).copy()
    else:
        # An overlapping view gathers the heads in one copy of a few bytes per message, so that the
        # operations below work on a small array instead of the whole chunk.
        every = np.ndarray((len(data) - size + 1,), f"V{size}", data, 0, (1,))[offsets]
        stride = 0
    headers = every.view(layout)
    if not _are_of(headers, connections):
        return None
    starts = offsets + size
    if np.count_nonzero(headers["size"] != stride - size):
        ends, stride = starts + headers["size"], 0
    else:
        ends = starts + (stride - size)
    if int(ends[-1]) > len(data) or (not stride and (offsets[1:] < ends[:-1]).any()):
        return None
    log_ns = _log_ns(headers)
    return MessageBlock(data, starts, ends, log_ns, log_ns, stride=stride)


def _are_of(headers: NDArray[np.void], connections: Iterable[int]) -> bool:
    """Return whether all headers are of messages of some connections, and of one layout."""
    count = sum(np.count_nonzero(headers["conn"] == conn) for conn in connections)
    wanted = {"length": headers.dtype.itemsize - 8, "op": OP_MESSAGE}
    return count == len(headers) and not any(
        np.count_nonzero(headers[name] != value) for name, value in wanted.items()
    )


def _log_ns(headers: NDArray[np.void]) -> NDArray[np.int64]:
    log_ns: NDArray[np.int64] = np.multiply(headers["sec"], NS_PER_S, dtype=np.int64)
    log_ns += headers["nsec"]
    return log_ns


def _message_layout(data: memoryview, at: int) -> np.dtype[np.void] | None:
    """Return the layout of the message header at `at`, as offsets from `at`."""
    try:
        header_end = header_end_of(data, at)
        places = {name: (begin - at, end - begin) for name, begin, end in
                  fields_of(data, at + 4, header_end)}  # fmt: skip
        (op, op_size), (conn, conn_size), (time, time_size) = (
            places[name] for name in (b"op", b"conn", b"time")
        )
    except (UnreadableDataError, KeyError):
        return None
    if (op_size, conn_size, time_size) != (1, 4, 8):
        return None
    size = header_end + 4 - at
    return np.dtype(
        {
            "names": ["length", "op", "conn", "sec", "nsec", "size"],
            "formats": ["<u4", "u1", "<u4", "<u4", "<u4", "<u4"],
            "offsets": [0, op, conn, time, time + 4, size - 4],
            "itemsize": size,
        }
    )
