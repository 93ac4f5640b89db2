"""Run a decoding plan on all messages of one or several blocks at once.

As long as the offset within a message is the same for all messages, it is one integer; after a
string or sequence of varying length it is an array, until an alignment makes the offsets equal
again. Every segment is checked against the end of each message before its bytes are fetched.
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
    """Some messages are shorter than the plan requires.

    `positions`: positions of these messages, shape ``(K,)``
    """

    def __init__(self, positions: Intp) -> None:
        super().__init__()
        self.positions = positions


class MixedError(Exception):
    """The messages have different encapsulations."""


@dataclass(frozen=True, slots=True, eq=False)
class MessageBytes:
    """Encoded messages of one byte order, in one or several buffers.

    `blocks`: the messages of each buffer, at least one
    `order`: byte order, ``"<"`` or ``">"``
    `origin`: offset in each message from which alignment is counted
    `shortest`: bytes of the shortest message
    `strides`: for each block the distance between messages, bytes, if it is constant; else 0
    """

    blocks: Sequence[MessageBlock]
    order: str
    origin: int
    shortest: int
    strides: Sequence[int]

    @classmethod
    def of(cls, blocks: Sequence[MessageBlock], order: str, origin: int) -> MessageBytes:
        """Return the messages of some blocks."""
        shortest = min(
            int(b.ends[0] - b.starts[0] if b.stride else (b.ends - b.starts).min()) for b in blocks
        )
        strides = [block.stride or _stride(block.starts) for block in blocks]
        return cls(blocks, order, origin, shortest, strides)

    def __len__(self) -> int:
        return sum(map(len, self.blocks))

    def at(self, positions: Intp) -> MessageBytes:
        """Return the messages at ascending positions."""
        return MessageBytes.of(take_messages(self.blocks, positions), self.order, self.origin)

    def require(self, ends: Offsets) -> None:
        """Raise TooShortError if a message ends before an offset."""
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
                # A window at every byte of the buffer: one indexing call copies those of all
                # messages.
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
    """Return messages by ascending positions, counted through all blocks."""
    begins = np.cumsum([0, *map(len, blocks)])
    bounds = positions.searchsorted(begins)
    return [
        block.at(positions[first:last] - begin)
        for block, begin, first, last in zip(blocks, begins, bounds, bounds[1:], strict=False)
        if first < last
    ]


def follow(plan: Plan, messages: MessageBytes, width: int) -> Columns:
    """Return the columns that a plan fetches.

    `Returns`: shape ``(N,)`` or ``(N, count)``, native byte order; never views of a block
    """
    columns: Columns = [np.empty(0)] * width
    _walk(plan, messages, 0, columns)
    return columns


def _walk(plan: Plan, messages: MessageBytes, offset: Offsets, columns: Columns) -> Offsets:
    """Run a plan from an offset on, fill the columns, and return the offset behind its end."""
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
            offset = offset + _size_of_elements(segment.ending, counts, offset - messages.origin)
        elif isinstance(segment.ending, Repeat):
            if segment.ending.length is not None:
                counts = segment.ending.length
            offset = _skip_elements(segment.ending.element, messages, offset, counts)
    return offset


def _stride(starts: Int64) -> int:
    """Return the distance between neighbours if it is constant, else 0."""
    if len(starts) == 1:
        return 0
    step = int(starts[1] - starts[0])
    # A quick test by the first and the last.
    if int(starts[-1] - starts[0]) != step * (len(starts) - 1):
        return 0
    return 0 if np.count_nonzero(starts[1:] - starts[:-1] != step) else step


def _common(values: int | AnyArray) -> Offsets:
    """Return one integer if all values are equal, else the array."""
    if isinstance(values, int):
        return values
    first = values[0]
    if np.count_nonzero(values != first):
        return values.astype(np.int64, copy=False)
    return int(first)


def _size_of_elements(skip: Skip, counts: Offsets, begin: Offsets) -> Offsets:
    """Return the bytes of `counts` elements of fixed size."""
    if skip.first is None:
        return counts * skip.further
    first = skip.first[begin & 7] if isinstance(begin, int) else np.array(skip.first)[begin & 7]
    # An empty sequence has no padding.
    return (first + (counts - 1) * skip.further) * (counts != 0)


def _skip_elements(
    element: Plan, messages: MessageBytes, offset: Offsets, counts: Offsets
) -> Offsets:
    """Return the offsets behind `counts` elements of varying size."""
    if isinstance(counts, int):
        # Every element takes bytes, so a wrong count reaches the end of its message.
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
