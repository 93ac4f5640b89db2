"""Gather values of messages that a library decodes one at a time into columns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.errors import MessageError
from quatprop.messages.columns import take_messages
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import Array, KeyPath, Primitive, Struct, Type, numeric_layout_at
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.arrays import AnyArray
    from quatprop.messages.blocks import Channel, MessageBlock


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
