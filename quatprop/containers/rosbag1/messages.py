"""Locate the messages of a connection in a decompressed chunk, all at once, by its index data."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.containers.rosbag1.records import (
    OP_MESSAGE,
    MalformedRecordError,
    fields_of,
    header_end_of,
)
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray


class MessageColumns(NamedTuple):
    """Where messages lie in a chunk, shapes ``(N,)``, and when they were recorded, ns."""

    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    log_ns: NDArray[np.int64]


def indexed_messages(
    data: NDArray[np.uint8], offsets: NDArray[np.int64], conn: int
) -> MessageColumns | None:
    """Locate the messages of one connection that the index points to.

    All headers are compared with the first, so that a wrong index is detected.

    Parameters
    ----------
    data
        The decompressed chunk, shape ``(B,)``.
    offsets
        Where their records begin by the index, shape ``(N,)``, ascending.
    conn
        Number of the connection.

    Returns
    -------
    MessageColumns or None
        None if anything there is not a message of this connection.
    """
    if len(offsets) == 0:
        return None
    first, last = int(offsets[0]), int(offsets[-1])
    layout = _message_layout(data.data, first)
    if layout is None or last + layout.itemsize > len(data):
        return None
    # An overlapping view gathers the heads with one copy of a few bytes a message; what follows
    # then works in a small array instead of the whole chunk.
    size = layout.itemsize
    every = np.ndarray((len(data) - size + 1,), f"V{size}", data, 0, (1,))
    headers = every[offsets].view(layout)
    if not (
        (headers["length"] == size - 8).all()
        and (headers["op"] == OP_MESSAGE).all()
        and (headers["conn"] == conn).all()
    ):
        return None
    starts = offsets + size
    ends = starts + headers["size"]
    if int(ends[-1]) > len(data) or not (offsets[1:] >= ends[:-1]).all():
        return None
    log_ns = headers["sec"].astype(np.int64)
    log_ns *= NS_PER_S
    log_ns += headers["nsec"]
    return MessageColumns(starts, ends, log_ns)


def _message_layout(data: memoryview, at: int) -> np.dtype[np.void] | None:
    """Return where the fields of the message header at `at` are, relative to `at`."""
    try:
        header_end = header_end_of(data, at)
        places = {name: (begin - at, end - begin) for name, begin, end in
                  fields_of(data, at + 4, header_end)}  # fmt: skip
        (op, op_size), (conn, conn_size), (time, time_size) = (
            places[name] for name in (b"op", b"conn", b"time")
        )
    except (MalformedRecordError, KeyError):
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
