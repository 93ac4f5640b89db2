"""Messages that are compressed one by one, as in ROS 2 bags with ``compression_mode: message``."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.stores.compression import UnreadableDataError, decompress

if TYPE_CHECKING:
    from quatprop.messages.blocks import MessageBlock

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""The first bytes of a compressed message; a message in CDR begins with 0."""


def decompressed(block: MessageBlock, encoding: str, *, is_known: bool) -> tuple[MessageBlock, int]:
    """Decompress zstd messages; return the intact messages and the number of damaged ones."""
    first = block.data[block.starts[0] : block.ends[0]][:4].tobytes()
    if not is_known and (encoding != "cdr" or first != ZSTD_MAGIC):
        return block, 0
    from zstandard import ZstdError, frame_content_size

    data = block.data.data
    messages = []
    intact = []
    for k, (start, end) in enumerate(zip(block.starts.tolist(), block.ends.tolist(), strict=True)):
        message = data[start:end]
        try:
            size = frame_content_size(message)
            messages.append(decompress(message, "zstd", size if size >= 0 else None))
        except (UnreadableDataError, ZstdError):
            continue
        intact.append(k)
    lengths = np.fromiter(map(len, messages), np.int64, len(messages))
    ends = np.cumsum(lengths)
    decompressed_block = replace(
        block.at(np.array(intact, np.intp)),
        data=np.frombuffer(b"".join(messages), np.uint8),
        starts=ends - lengths,
        ends=ends,
    )
    return decompressed_block, len(block) - len(intact)
