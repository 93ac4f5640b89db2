"""Decode protobuf messages by the file descriptors that the log carries.

Google's library, an optional extra, decodes one message of each layout; the numbers of all others
with that layout are read at once.
"""

from __future__ import annotations

import math
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.errors import MessageError
from quatprop.messages.columns import MessageBytes, take_messages
from quatprop.messages.plan import Window
from quatprop.messages.protobuf_layout import ProtobufLayout
from quatprop.messages.schema import BadDefinitionError, Primitive, Sequence, String, Struct
from quatprop.messages.values import ValueDecoder
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from collections.abc import Sequence as Paths
    from pathlib import Path

    from quatprop.arrays import AnyArray, Bool, Intp
    from quatprop.messages.blocks import Channel, MessageBlock
    from quatprop.messages.schema import KeyPath, Type

NUMBERS: Mapping[int, Primitive] = {
    1: Primitive("f8"),  # double
    2: Primitive("f4"),  # float
    3: Primitive("i8"),  # int64
    4: Primitive("u8"),  # uint64
    5: Primitive("i4"),  # int32
    6: Primitive("u8"),  # fixed64
    7: Primitive("u4"),  # fixed32
    8: Primitive("b1"),  # bool
    13: Primitive("u4"),  # uint32
    14: Primitive("i4"),  # enum
    15: Primitive("i4"),  # sfixed32
    16: Primitive("i8"),  # sfixed64
    17: Primitive("i4"),  # sint32
    18: Primitive("i8"),  # sint64
}
"""Number types by the field type in a descriptor."""

MESSAGES = (10, 11)
"""Field types of groups and messages."""

_FEW, _LONGEST = 16, 1 << 12
"""Fewer messages of a layout, and longer messages (bytes), are decoded one by one."""


def message_type(channel: Channel) -> Struct:
    """Return the type of a channel's messages.

    `channel`: its schema is a serialised ``FileDescriptorSet``
    """
    return _struct(_message_class(channel.type_name, channel.schema).DESCRIPTOR, {})


@lru_cache(maxsize=256)
def _message_class(type_name: str, schema: bytes) -> Any:
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
        from google.protobuf.message import DecodeError
    except ImportError:
        raise BadDefinitionError(
            f"{quoted(type_name)} is encoded as protobuf, which needs the package protobuf; "
            "pip install protobuf, or choose another topic"
        ) from None
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema)
        pool = descriptor_pool.DescriptorPool()
        _add(pool, {file.name: file for file in files.file})
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(type_name))
    except (DecodeError, KeyError, RecursionError, TypeError, ValueError):
        raise BadDefinitionError(
            f"the file descriptors that the log carries cannot be read, or do not define "
            f"{quoted(type_name)}; record it with all files that it imports"
        ) from None


def _add(pool: Any, files: Mapping[str, Any]) -> None:
    """Add files to a pool, imported files first, whatever their order in the log."""
    from google.protobuf import descriptor_pb2, duration_pb2, timestamp_pb2, wrappers_pb2

    # Some recorders omit these, which every protobuf library has.
    known = (module.DESCRIPTOR for module in (duration_pb2, timestamp_pb2, wrappers_pb2))
    read = descriptor_pb2.FileDescriptorProto.FromString
    waiting = {file.name: read(file.serialized_pb) for file in known} | dict(files)

    def add(name: str) -> None:
        if name in waiting:
            file = waiting.pop(name)
            for imported in file.dependency:
                add(imported)
            pool.Add(file)

    for name in files:
        add(name)


def _struct(descriptor: Any, structs: dict[str, Struct]) -> Struct:
    name: str = descriptor.full_name
    if name not in structs:
        # A type may contain itself, to any depth: the inner one gets no fields.
        structs[name] = Struct(name, ())
        structs[name] = Struct(name, tuple((f.name, _type(f, structs)) for f in descriptor.fields))
    return structs[name]


def _type(field: Any, structs: dict[str, Struct]) -> Type:
    kind: Type
    if field.type in NUMBERS:
        kind = NUMBERS[field.type]
    elif field.type in MESSAGES:
        kind = _struct(field.message_type, structs)
    else:  # strings and bytes
        kind = String()
    return Sequence(kind) if field.is_repeated else kind


class ProtobufDecoder(ValueDecoder):
    """Decodes fields of protobuf messages.

    Floats in a message that is not set are NaN; other numbers that are not set have protobuf's
    default value.
    """

    def __init__(self, channel: Channel, field_paths: Paths[str], path: Path | str) -> None:
        super().__init__(channel, field_paths, path)
        self._class = _message_class(channel.type_name, channel.schema)

    def columns(self, *blocks: MessageBlock) -> list[AnyArray]:
        """Return the wanted fields of all messages in some blocks, one layout at a time."""
        lengths = np.concatenate([block.ends - block.starts for block in blocks])
        shapes = [() if wanted.single else (len(wanted.key_paths),) for wanted in self.wanted]
        columns = [
            np.empty((len(lengths), *shape), self._dtype(wanted))
            for wanted, shape in zip(self.wanted, shapes, strict=True)
        ]
        others = np.ones(len(lengths), np.bool_)
        for length, count in zip(*np.unique_counts(lengths), strict=True):
            if count >= _FEW and 0 < length <= _LONGEST:
                self._of_length(blocks, np.flatnonzero(lengths == length), columns, others)
        rest = np.flatnonzero(others)
        try:
            values = super().columns(*take_messages(blocks, rest))
        except MessageError as error:
            raise self._undecodable(blocks, rest[[*error.positions]].tolist()) from None
        for column, own in zip(columns, values, strict=True):
            column[rest] = own
        return columns

    def _of_length(
        self, blocks: Paths[MessageBlock], rest: Intp, columns: list[AnyArray], others: Bool
    ) -> None:
        """Decode messages of one length, as long as many share a layout; clear them in `others`."""
        own = MessageBytes.of(take_messages(blocks, rest), "<", 0)
        messages = own.window(Window(0, own.shortest, ()), 0).view(np.uint8).reshape(len(rest), -1)
        while len(rest) >= _FEW:
            raw = messages[0].tobytes()
            try:
                first = self._parsed(raw)
                layout = ProtobufLayout(raw, first.DESCRIPTOR)
                values = [self._values(first, wanted) for wanted in self.wanted]
            except (LookupError, RecursionError, ValueError):
                return
            alike = layout.is_shared_by(messages)
            taken, numbers = rest[alike], partial(layout.numbers, messages[alike])
            for column, wanted, value in zip(columns, self.wanted, values, strict=True):
                column[taken] = value
                for k, key_path in enumerate(wanted.key_paths):
                    if key_path in layout.numeric_fields:
                        cells = taken if wanted.single else (taken, k)
                        column[cells] = numbers(key_path, wanted.number.code)
            others[taken] = False
            if len(taken) < _FEW:
                return
            messages, rest = messages[~alike], rest[~alike]

    def _parsed(self, raw: bytes) -> Any:
        from google.protobuf.message import DecodeError

        try:
            return self._class.FromString(raw)
        except DecodeError as error:
            raise ValueError from error

    def _value(self, message: Any, key_path: KeyPath, number: Primitive) -> Any:
        value = message
        for key in key_path[:-1]:
            if not value.HasField(key):
                if number.code[0] == "f":
                    return math.nan
                raise LookupError
            value = getattr(value, str(key))
        return getattr(value, str(key_path[-1]))
