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

_LOOKED_AT = 5
"""Number of messages that show whether those of a block are compressed: one may be damaged."""


def decompressed(block: MessageBlock, encoding: str, *, is_known: bool) -> tuple[MessageBlock, int]:
    """Decompress zstd messages; return the intact messages and the number of damaged ones."""
    spans = zip(block.starts[:_LOOKED_AT], block.ends[:_LOOKED_AT], strict=True)
    heads = (block.data[start:end][:4].tobytes() for start, end in spans)
    if not is_known and (encoding != "cdr" or ZSTD_MAGIC not in heads):
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
