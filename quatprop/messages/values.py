"""Messages that a library decodes one at a time: the wanted values, gathered into columns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.errors import MessageError
from quatprop.messages.columns import take_messages
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import Array, Primitive, Steps, Struct, Type, numeric_layout_at
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.arrays import AnyArray
    from quatprop.messages.blocks import Channel, MessageBlock


@dataclass(frozen=True, slots=True)
class WantedColumn:
    """One column.

    `ways`: where its numbers are: one, or those of a row
    `single`: whether it is a number and not a row of one
    """

    ways: tuple[Steps, ...]
    number: Primitive
    single: bool


class ValueDecoder(ABC):
    """Takes fields out of messages, one message after the other.

    `channel`: whose messages, with their definition
    `field_paths`: dotted paths of the wanted fields
    """

    def __init__(self, channel: Channel, field_paths: Sequence[str], path: Path | str) -> None:
        self.channel = channel
        self.path = path
        root = message_type(channel, path)
        self.wanted = [self._wanted(root, field_path) for field_path in field_paths]

    def _wanted(self, root: Struct, field_path: str) -> WantedColumn:
        way, kind, number, _ = numeric_layout_at(self.channel, root, field_path, self.path)
        return WantedColumn(tuple(_leaves(way, kind)), number, isinstance(kind, Primitive))

    def columns(self, *blocks: MessageBlock) -> list[AnyArray]:
        """Return the wanted fields of all messages of blocks."""
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
        """Return a message; ValueError where the bytes are none."""

    @abstractmethod
    def _value(self, message: Any, way: Steps, number: Primitive) -> Any:
        """Return a number of a message; NaN for an optional one that is absent."""

    def _dtype(self, wanted: WantedColumn) -> np.dtype[Any]:
        return np.dtype(wanted.number.code)

    def _values(self, message: Any, wanted: WantedColumn) -> Any:
        values = [self._value(message, way, wanted.number) for way in wanted.ways]
        if wanted.single:
            return values[0]
        # Converted here, so that a number too large for its column counts against its message.
        return np.array(values, wanted.number.code)

    def _column(self, wanted: WantedColumn, values: Sequence[Any]) -> AnyArray:
        shape = (len(values),) if wanted.single else (len(values), len(wanted.ways))
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


def _leaves(way: Steps, kind: Type) -> Iterator[Steps]:
    """Yield the ways to the numbers that a field is made of, in order."""
    if isinstance(kind, Struct):
        for name, part in kind.fields:
            yield from _leaves((*way, name), part)
    elif isinstance(kind, Array):
        for position in range(kind.length):
            yield from _leaves((*way, position), kind.element)
    else:
        yield way
