"""Messages one by one: joined into a block, and unpacked where each was packed by itself.

ROS 2 bags do that with ``compression_mode: message``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.readers.base import NO_BOUND, MessageBlock
from quatprop.readers.compression import CompressionError, decompress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""How a packed message begins; one in CDR begins with 0."""


def joined(
    messages: Sequence[bytes | bytearray | memoryview],
    log_ns: NDArray[np.int64],
    publish_ns: NDArray[np.int64],
    not_before_ns: int = NO_BOUND,
) -> MessageBlock:
    """Join messages into a block.

    Parameters
    ----------
    messages
        ``N`` messages.
    log_ns, publish_ns
        When each was recorded and published, shape ``(N,)``, int64 ns.
    not_before_ns
        As in :class:`~quatprop.readers.base.MessageBlock`.

    Returns
    -------
    MessageBlock
        The messages, one after another.
    """
    lengths = np.fromiter(map(len, messages), np.int64, len(messages))
    ends = np.cumsum(lengths)
    data = np.frombuffer(b"".join(messages), np.uint8)
    return MessageBlock(data, ends - lengths, ends, log_ns, publish_ns, not_before_ns)


def together(blocks: Sequence[MessageBlock]) -> MessageBlock:
    """Return blocks that follow each other as one, copied.

    Parameters
    ----------
    blocks
        At least one block; the last one's promise is kept.
    """
    if len(blocks) == 1:
        return blocks[0]
    shifts = np.cumsum([0, *(len(block.data) for block in blocks[:-1])])
    return MessageBlock(
        np.concatenate([block.data for block in blocks]),
        np.concatenate([block.starts + shift for block, shift in zip(blocks, shifts, strict=True)]),
        np.concatenate([block.ends + shift for block, shift in zip(blocks, shifts, strict=True)]),
        np.concatenate([block.log_ns for block in blocks]),
        np.concatenate([block.publish_ns for block in blocks]),
        blocks[-1].not_before_ns,
    )


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
    log_ns, publish_ns = block.log_ns[kept], block.publish_ns[kept]
    return joined(messages, log_ns, publish_ns, block.not_before_ns), len(block) - len(whole)
