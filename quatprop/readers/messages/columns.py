"""Run a decoding plan on all messages of one or several blocks at once.

As long as the offset within a message is the same for all messages, it is one integer; after a
string or sequence of varying length it is an array, until an alignment makes the offsets equal
again. Every segment is checked against the end of each message before its bytes are fetched.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from quatprop.base.errors import MessageError
from quatprop.base.text import quoted
from quatprop.readers.messages.compiler import (
    COUNT,
    ENCAPSULATION,
    Piece,
    Plan,
    Repeat,
    Skip,
    Window,
)
from quatprop.readers.messages.definitions import message_type
from quatprop.readers.messages.schema import (
    Array,
    KeyPath,
    Primitive,
    Struct,
    Type,
    numeric_layout_at,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray, Int64, Intp, Records
    from quatprop.readers.messages.blocks import Channel, MessageBlock

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


# Gather values of messages that a library decodes one at a time into columns.


@dataclass(frozen=True, slots=True)
class WantedColumn:
    """A column of numbers, or of rows of numbers.

    `key_paths`: of the number, or of each number of a row
    `single`: whether it holds numbers, rather than rows of one
    """

    key_paths: tuple[KeyPath, ...]
    number: Primitive
    single: bool


class ValueDecoder(ABC):
    """Decodes fields of messages, one message after another.

    `channel`: the channel to decode, with its definition
    `field_paths`: dotted paths of the wanted fields
    """

    def __init__(self, channel: Channel, field_paths: Sequence[str], path: Path | str) -> None:
        self.channel = channel
        self.path = path
        root = message_type(channel, path)
        self.wanted = [self._wanted(root, field_path) for field_path in field_paths]

    def _wanted(self, root: Struct, field_path: str) -> WantedColumn:
        key_path, kind, number, _ = numeric_layout_at(self.channel, root, field_path, self.path)
        return WantedColumn(tuple(_leaves(key_path, kind)), number, isinstance(kind, Primitive))

    def columns(self, *blocks: MessageBlock) -> list[AnyArray]:
        """Return the wanted fields of all messages in some blocks."""
        values: list[list[Any]] = []
        bad: list[int] = []
        for position, raw in enumerate(raw_messages(*blocks)):
            try:
                message = self._parsed(raw)
                values.append([self._values(message, wanted) for wanted in self.wanted])
            except (ArithmeticError, LookupError, RecursionError, TypeError, ValueError):
                bad.append(position)
        if bad:
            raise self._undecodable(blocks, bad)
        rows = zip(*values, strict=True) if values else iter([()] * len(self.wanted))
        return [self._column(wanted, row) for wanted, row in zip(self.wanted, rows, strict=True)]

    @abstractmethod
    def _parsed(self, raw: bytes) -> Any:
        """Return a parsed message; raise ValueError if it cannot be parsed."""

    @abstractmethod
    def _value(self, message: Any, key_path: KeyPath, number: Primitive) -> Any:
        """Return one number of a message; NaN for an optional one that is absent."""

    def _dtype(self, wanted: WantedColumn) -> np.dtype[Any]:
        return np.dtype(wanted.number.code)

    def _values(self, message: Any, wanted: WantedColumn) -> Any:
        values = [self._value(message, key_path, wanted.number) for key_path in wanted.key_paths]
        if wanted.single:
            return values[0]
        # Converted here, so that a number too large for its column is an error of its message.
        return np.array(values, wanted.number.code)

    def _column(self, wanted: WantedColumn, values: Sequence[Any]) -> AnyArray:
        shape = (len(values),) if wanted.single else (len(values), len(wanted.key_paths))
        return np.array(values, self._dtype(wanted)).reshape(shape)

    def _undecodable(self, blocks: Sequence[MessageBlock], bad: list[int]) -> MessageError:
        (first,) = take_messages(blocks, np.array(bad[:1]))
        others = f" and {len(bad) - 1} others" if len(bad) > 1 else ""
        return MessageError(
            self.path,
            f"the message of topic {quoted(self.channel.topic)} recorded at "
            f"{first.log_ns[0]} ns{others} cannot be decoded as {self.channel.encoding} with "
            "the wanted fields; the log is damaged or its messages differ",
            bad,
        )


def raw_messages(*blocks: MessageBlock) -> Iterator[bytes]:
    """Yield the bytes of every message."""
    for block in blocks:
        data = block.data.data
        for begin, end in zip(block.starts.tolist(), block.ends.tolist(), strict=True):
            yield bytes(data[begin:end])


def _leaves(key_path: KeyPath, kind: Type) -> Iterator[KeyPath]:
    """Yield the key paths of the numbers in a field, in order."""
    if isinstance(kind, Struct):
        for name, part in kind.fields:
            yield from _leaves((*key_path, name), part)
    elif isinstance(kind, Array):
        for position in range(kind.length):
            yield from _leaves((*key_path, position), kind.element)
    else:
        yield key_path
