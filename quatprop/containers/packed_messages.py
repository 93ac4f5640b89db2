"""Messages that were packed one by one, as ROS 2 bags do with ``compression_mode: message``."""

from __future__ import annotations

import numpy as np

from quatprop.containers.base import MessageBlock
from quatprop.containers.compression import CompressionError, decompress

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""How a packed message begins; one in CDR begins with 0."""


def is_packed(block: MessageBlock) -> bool:
    """Tell whether a block begins with a message that is packed with zstd."""
    return block.data[block.starts[0] : block.ends[0]][:4].tobytes() == ZSTD_MAGIC


def unpacked(block: MessageBlock) -> tuple[MessageBlock, int]:
    """Unpack messages that are packed with zstd, each by itself.

    Parameters
    ----------
    block
        The packed messages.

    Returns
    -------
    MessageBlock
        The messages that could be unpacked.
    int
        How many could not.
    """
    from zstandard import ZstdError, frame_content_size

    data = block.data.data
    messages = []
    whole = []
    for k, (start, end) in enumerate(zip(block.starts.tolist(), block.ends.tolist(), strict=True)):
        packed = data[start:end]
        try:
            size = frame_content_size(packed)
            messages.append(decompress(packed, "zstd", size if size >= 0 else None))
        except (CompressionError, ZstdError):
            continue
        whole.append(k)
    kept = np.array(whole, np.int64)
    lengths = np.fromiter(map(len, messages), np.int64, len(messages))
    ends = np.cumsum(lengths)
    joined = MessageBlock(
        np.frombuffer(b"".join(messages), np.uint8),
        ends - lengths,
        ends,
        block.log_ns[kept],
        block.publish_ns[kept],
        block.not_before_ns,
    )
    return joined, len(block) - len(whole)
