"""Protobuf messages, defined by the file descriptors that the log carries.

Google's library decodes them one by one. It is an extra.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from quatprop.messages.schema import (
    BadDefinitionError,
    Primitive,
    Sequence,
    String,
    Struct,
    Unknown,
)
from quatprop.messages.values import ValueDecoder
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from collections.abc import Sequence as Paths
    from pathlib import Path

    from quatprop.messages.blocks import Channel
    from quatprop.messages.schema import Steps, Type

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
"""Numbers by the type of a field in its descriptor."""

TEXTS = (9, 12)
"""Types of strings and bytes."""

MESSAGES = (10, 11)
"""Types of groups and messages."""


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
    """Add files to a pool, those that others import first, in whatever order the log has them."""
    from google.protobuf import descriptor_pb2, duration_pb2, timestamp_pb2, wrappers_pb2

    # Every program that reads protobuf has these, so some recorders leave them out.
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
        # A type may contain itself, to any depth: it is not searched for rates.
        structs[name] = Struct(name, ())
        structs[name] = Struct(name, tuple((f.name, _type(f, structs)) for f in descriptor.fields))
    return structs[name]


def _type(field: Any, structs: dict[str, Struct]) -> Type:
    kind: Type
    if field.type in NUMBERS:
        kind = NUMBERS[field.type]
    elif field.type in TEXTS:
        kind = String()
    elif field.type in MESSAGES:
        kind = _struct(field.message_type, structs)
    else:
        kind = Unknown(field.name)
    return Sequence(kind) if field.is_repeated else kind


class ProtobufDecoder(ValueDecoder):
    """Takes fields out of protobuf messages.

    Rates whose message is not set are NaN; other numbers that are not set have the default value
    of protobuf.
    """

    def __init__(self, channel: Channel, field_paths: Paths[str], path: Path | str) -> None:
        super().__init__(channel, field_paths, path)
        self._class = _message_class(channel.type_name, channel.schema)

    def _parsed(self, raw: bytes) -> Any:
        from google.protobuf.message import DecodeError

        try:
            return self._class.FromString(raw)
        except DecodeError as error:
            raise ValueError from error

    def _value(self, message: Any, way: Steps, number: Primitive) -> Any:
        value = message
        for step in way[:-1]:
            if not value.HasField(step):
                if number.code[0] == "f":
                    return math.nan
                raise LookupError
            value = getattr(value, str(step))
        return getattr(value, str(way[-1]))
