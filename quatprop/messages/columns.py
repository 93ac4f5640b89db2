"""Follow a decoding plan through all messages of a block, or of several, at once.

While all messages agree, the offset within a message is one integer; after a string or sequence of
differing lengths it is an array, until an alignment makes the offsets equal again. Every segment is
checked against the end of each message before a byte of it is fetched.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from quatprop.messages.plan import COUNT, ENCAPSULATION, Piece, Plan, Repeat, Skip, Window

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.arrays import AnyArray, Int64, Intp, Records
    from quatprop.messages.blocks import MessageBlock

    Offsets: TypeAlias = int | Int64
    Columns: TypeAlias = list[AnyArray]

NATIVE = "<" if np.little_endian else ">"


class TooShortError(Exception):
    """Messages end before what the plan needs.

    `positions`: which of the messages, shape ``(K,)``
    """

    def __init__(self, positions: Intp) -> None:
        super().__init__()
        self.positions = positions


class MixedError(Exception):
    """The messages are not all encapsulated like the first."""


@dataclass(frozen=True, slots=True, eq=False)
class MessageBytes:
    """Encoded messages of one byte order, in one buffer or several.

    `blocks`: the messages of each buffer, at least one
    `order`: byte order, ``"<"`` or ``">"``
    `origin`: where in each message alignment is counted from
    `shortest`: bytes of the shortest message
    `strides`: of each block the bytes from one message to the next where that is always the same,
        else 0
    """

    blocks: Sequence[MessageBlock]
    order: str
    origin: int
    shortest: int
    strides: Sequence[int]

    @classmethod
    def of(cls, blocks: Sequence[MessageBlock], order: str, origin: int) -> MessageBytes:
        """Return messages with the length of the shortest and their strides."""
        shortest = min(
            int(b.ends[0] - b.starts[0] if b.stride else (b.ends - b.starts).min()) for b in blocks
        )
        strides = [block.stride or _stride(block.starts) for block in blocks]
        return cls(blocks, order, origin, shortest, strides)

    def __len__(self) -> int:
        return sum(map(len, self.blocks))

    def at(self, positions: Intp) -> MessageBytes:
        """Return some of the messages, at ascending positions."""
        return MessageBytes.of(take_messages(self.blocks, positions), self.order, self.origin)

    def require(self, ends: Offsets) -> None:
        """Check that no message ends before an offset."""
        if isinstance(ends, int) and ends <= self.shortest:
            return
        short = np.concatenate([block.ends - block.starts for block in self.blocks]) < ends
        if np.count_nonzero(short):
            raise TooShortError(np.flatnonzero(short))

    def window(self, window: Window, offset: Offsets) -> Records:
        """Return a copy of the bytes of a window in each message, shape ``(N,)``."""
        kind = np.dtype((np.void, window.size))
        fetched: Records = np.empty(len(self), kind)
        begin = 0
        for block, stride in zip(self.blocks, self.strides, strict=True):
            end = begin + len(block)
            if stride and isinstance(offset, int):
                first = int(block.starts[0]) + offset + window.offset
                own = np.ndarray((len(block),), kind, block.data, first, (stride,))
            else:
                here = offset if isinstance(offset, int) else offset[begin:end]
                # All windows of the buffer, one byte apart: indexing them copies each message's
                # window in a single call.
                shape = (len(block.data) - window.size + 1,)
                windows: Records = np.ndarray(shape, kind, block.data, 0, (1,))
                own = windows[block.starts + (here + window.offset)]
            fetched[begin:end] = own
            begin = end
        return fetched

    def numbers(self, piece: Piece, window: Records) -> AnyArray:
        """Return the numbers of a piece in each message, shape ``(N,)`` or ``(N, count)``."""
        number, step = piece.number, window.itemsize
        code = "u1" if number.code == "b1" else number.code
        shape: tuple[int, ...] = (len(window),)
        strides: tuple[int, ...] = (step,)
        if piece.length is not None:
            shape += (piece.length,)
            strides += (number.size,)
        stored: AnyArray = np.ndarray(shape, self.order + code, window, piece.offset, strides)
        if number.code == "b1":
            stored = stored != 0
        return stored if self.order == NATIVE else stored.astype(NATIVE + code)


def take_messages(blocks: Sequence[MessageBlock], positions: Intp) -> list[MessageBlock]:
    """Return some messages of blocks, by their ascending positions among those of all blocks."""
    begins = np.cumsum([0, *map(len, blocks)])
    bounds = positions.searchsorted(begins)
    return [
        block.at(positions[first:last] - begin)
        for block, begin, first, last in zip(blocks, begins, bounds, bounds[1:], strict=False)
        if first < last
    ]


def follow(plan: Plan, messages: MessageBytes, width: int) -> Columns:
    """Return the columns that a plan takes.

    `Returns`: shape ``(N,)`` or ``(N, count)``, native byte order; views of memory of their own
    """
    columns: Columns = [np.empty(0)] * width
    _walk(plan, messages, 0, columns)
    return columns


def _walk(plan: Plan, messages: MessageBytes, offset: Offsets, columns: Columns) -> Offsets:
    """Follow a plan from an offset on, fill the columns, and return the offset behind it."""
    for segment in plan:
        if segment.alignment > 1:
            offset = offset + ((messages.origin - offset) & (segment.alignment - 1))
        offset = _common(offset)
        messages.require(offset + segment.reach)
        counts: Offsets = 0
        for window in segment.windows:
            taken = messages.window(window, offset)
            for piece in window.pieces:
                values = messages.numbers(piece, taken)
                if piece.column == COUNT:
                    counts = _common(values)
                elif piece.column != ENCAPSULATION:
                    columns[piece.column] = values
                elif np.count_nonzero(values != values[0]):
                    raise MixedError
        offset = offset + segment.size
        if isinstance(segment.ending, Skip):
            offset = offset + _skipped(segment.ending, counts, offset - messages.origin)
        elif isinstance(segment.ending, Repeat):
            if segment.ending.length is not None:
                counts = segment.ending.length
            offset = _repeated(segment.ending.element, messages, offset, counts)
    return offset


def _stride(starts: Int64) -> int:
    """Return the distance between neighbours where it is always the same, else 0."""
    if len(starts) == 1:
        return 0
    step = int(starts[1] - starts[0])
    # The ends tell quickly where it cannot be.
    if int(starts[-1] - starts[0]) != step * (len(starts) - 1):
        return 0
    return 0 if np.count_nonzero(starts[1:] - starts[:-1] != step) else step


def _common(values: int | AnyArray) -> Offsets:
    """Return one integer where all messages agree."""
    if isinstance(values, int):
        return values
    first = values[0]
    if np.count_nonzero(values != first):
        return values.astype(np.int64, copy=False)
    return int(first)


def _skipped(skip: Skip, counts: Offsets, begin: Offsets) -> Offsets:
    """Return the bytes of so many elements of fixed size."""
    if skip.first is None:
        return counts * skip.further
    first = skip.first[begin & 7] if isinstance(begin, int) else np.array(skip.first)[begin & 7]
    # Nothing is padded where there is nothing.
    return (first + (counts - 1) * skip.further) * (counts != 0)


def _repeated(element: Plan, messages: MessageBytes, offset: Offsets, counts: Offsets) -> Offsets:
    """Return the offsets behind so many elements of varying size."""
    if isinstance(counts, int):
        # Every element takes bytes, so a wrong count runs into the end of its message.
        for _ in range(counts):
            offset = _walk(element, messages, offset, [])
        return offset
    offsets = np.empty(len(counts), np.int64)
    offsets[:] = offset
    remaining = np.flatnonzero(counts)
    done = 0
    while len(remaining):
        try:
            offsets[remaining] = _walk(
                element, messages.at(remaining), _common(offsets[remaining]), []
            )
        except TooShortError as error:
            raise TooShortError(remaining[error.positions]) from None
        done += 1
        remaining = remaining[counts[remaining] > done]
    return offsets
