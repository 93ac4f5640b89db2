"""Decode protobuf messages by the file descriptors that the log carries.

Google's library, an optional extra, decodes one message of each layout; the numbers of all others
with that layout are read at once.
"""

from __future__ import annotations

import math
from contextlib import suppress
from functools import lru_cache, partial, reduce
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from quatprop.base.errors import MessageError
from quatprop.base.text import quoted
from quatprop.readers.messages.columns import (
    MessageBytes,
    ValueDecoder,
    raw_messages,
    take_messages,
)
from quatprop.readers.messages.compiler import Window
from quatprop.readers.messages.schema import (
    BadDefinitionError,
    Primitive,
    Sequence,
    String,
    Struct,
    key_path_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from collections.abc import Sequence as Paths
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.base.arrays import AnyArray, Bool, Int64, Intp
    from quatprop.readers.messages.blocks import Channel, MessageBlock
    from quatprop.readers.messages.schema import KeyPath, Type


# The layout of a protobuf message: the offsets of its numbers, shared by similar messages.
#
# Written by hand because the library returns one value of one message at a time. It still decodes
# and checks one message of each layout; of the others, only the numbers are read from the bytes.
#
# Reference: Protocol Buffers Documentation, "Encoding".


_VARINT, _EIGHT_BYTES, _LENGTH, _FOUR_BYTES = 0, 1, 2, 5
_WIRE_TYPES = {
    **dict.fromkeys((1, 6, 16), _EIGHT_BYTES),
    **dict.fromkeys((2, 7, 15), _FOUR_BYTES),
    # Enums are excluded: the library drops unknown values of some.
    **dict.fromkeys((3, 4, 5, 8, 13, 17, 18), _VARINT),
    **dict.fromkeys((11, 12), _LENGTH),
}
"""Wire type by field type. Fields of other types are compared byte by byte, never read."""

_MESSAGE, _ZIGZAG = 11, (17, 18)
_EVERY_BIT, _CONTINUES = 0xFF, 0x80
_LONGEST_VARINT = 10


class Place(NamedTuple):
    """The offsets of a value and the type of its field."""

    begin: int
    end: int
    kind: int


class ProtobufLayout:
    """The layout of a message that the library has decoded.

    `numeric_fields`: places of the numbers that are set, by key path

    Raises LookupError if the message has a group, or a field twice that is not repeated.
    """

    def __init__(self, raw: bytes, message: Any) -> None:
        self.numeric_fields: dict[KeyPath, Place] = {}
        self._raw = np.frombuffer(raw, np.uint8)
        # The bits that another message must have in common: tags, lengths and texts.
        self._common = np.full(len(raw), _EVERY_BIT, np.uint8)
        self._walk(0, len(raw), message, ())

    def is_shared_by(self, messages: NDArray[np.uint8]) -> Bool:
        """Return which messages of the same length have this layout, a mask of shape ``(N,)``.

        `messages`: their bytes, shape ``(N, length)``
        """
        at = np.flatnonzero(self._common)
        differs = (messages[:, at] ^ self._raw[at]) & self._common[at]
        alike: Bool = np.logical_not(differs.any(axis=1))
        return alike

    def numbers(self, messages: NDArray[np.uint8], key_path: KeyPath, code: str) -> AnyArray:
        """Return one number of each message of this layout, shape ``(N,)``.

        `code`: NumPy's type code of the number
        """
        begin, end, kind = self.numeric_fields[key_path]
        values: AnyArray
        if _WIRE_TYPES[kind] != _VARINT:
            strides = messages.strides[:1]
            values = np.ndarray((len(messages),), f"<{code}", messages, begin, strides)
            return values
        values = np.zeros(len(messages), np.uint64)
        for position in range(begin, end):
            part = (messages[:, position] & ~np.uint8(_CONTINUES)).astype(np.uint64)
            values |= part << np.uint64(7 * (position - begin))
        if kind in _ZIGZAG:
            bits = values.astype(f"u{code[1:]}")
            values = (bits >> 1 ^ -(bits & 1)).view(code)
        # Integers of fewer bits are truncated; a boolean is true unless it is zero.
        numbers: AnyArray = values.astype(code)
        return numbers

    def _walk(self, at: int, end: int, message: Any, key_path: KeyPath | None) -> None:
        """Record the values in a part of the message; `key_path` is None inside repeated fields."""
        names: set[str] = set()
        while at < end:
            tag, at = self._varint(at)
            begin, at = self._value(at, tag & 7)
            field = message.fields_by_number.get(tag >> 3)
            if field is None:
                continue
            if not field.is_repeated:
                # In a oneof the last field would count, and messages would be merged.
                name = (field.containing_oneof or field).full_name
                if name in names:
                    raise LookupError(name)
                names.add(name)
            if _WIRE_TYPES.get(field.type) == tag & 7:
                inner = None if key_path is None or field.is_repeated else (*key_path, field.name)
                self._record(Place(begin, at, field.type), field, inner)
            elif field.is_repeated and _WIRE_TYPES.get(field.type) in {_EIGHT_BYTES, _FOUR_BYTES}:
                self._common[begin:at] = 0  # a packed field

    def _record(self, place: Place, field: Any, key_path: KeyPath | None) -> None:
        """Record the place of a value, and exclude its bits from the comparison."""
        begin, end, kind = place
        if kind == _MESSAGE:
            self._walk(begin, end, field.message_type, key_path)
            return
        if _WIRE_TYPES[kind] == _VARINT:
            # The last byte of the longest varints is compared: it has one bit of the number.
            self._common[begin : min(end, begin + _LONGEST_VARINT - 1)] = _CONTINUES
        else:
            self._common[begin:end] = 0
        if key_path is not None:
            self.numeric_fields[key_path] = place

    def _value(self, at: int, wire_type: int) -> tuple[int, int]:
        """Return the offsets of a value of a wire type, behind its length if it has one."""
        value, end = self._varint(at) if wire_type in {_VARINT, _LENGTH} else (0, at)
        if wire_type == _VARINT:
            return at, end
        sizes = {_EIGHT_BYTES: 8, _FOUR_BYTES: 4, _LENGTH: value}
        return end, end + sizes[wire_type]

    def _varint(self, at: int) -> tuple[int, int]:
        """Return the number at an offset, and the offset behind it."""
        value = shift = 0
        while True:
            byte = int(self._raw[at])
            value |= (byte & ~_CONTINUES) << shift
            at, shift = at + 1, shift + 7
            if byte < _CONTINUES:
                return value, at


Values = TypeVar("Values")

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


_MISFITS = (LookupError, RecursionError, ValueError)
"""Errors of messages that have no layout, or cannot be parsed."""


def _parsed(message_class: Any, raw: bytes) -> Any:
    from google.protobuf.message import DecodeError

    try:
        return message_class.FromString(raw)
    except DecodeError as error:
        raise ValueError from error


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
        for first, layout, taken, messages in _alike(blocks, self._first, others):
            for column, wanted, value in zip(columns, self.wanted, first, strict=True):
                column[taken] = value
                for k, key_path in enumerate(wanted.key_paths):
                    if key_path in layout.numeric_fields:
                        cells = taken if wanted.single else (taken, k)
                        column[cells] = layout.numbers(messages, key_path, wanted.number.code)
        rest = np.flatnonzero(others)
        try:
            values = super().columns(*take_messages(blocks, rest))
        except MessageError as error:
            raise self._undecodable(blocks, rest[[*error.positions]].tolist()) from None
        for column, own in zip(columns, values, strict=True):
            column[rest] = own
        return columns

    def _first(self, raw: bytes) -> tuple[Any, list[Any]]:
        """Return a message and its wanted values."""
        message = self._parsed(raw)
        return message, [self._values(message, wanted) for wanted in self.wanted]

    def _parsed(self, raw: bytes) -> Any:
        return _parsed(self._class, raw)

    def _value(self, message: Any, key_path: KeyPath, number: Primitive) -> Any:
        value = message
        for key in key_path[:-1]:
            if not value.HasField(key):
                if number.code[0] == "f":
                    return math.nan
                raise LookupError
            value = getattr(value, str(key))
        return getattr(value, str(key_path[-1]))


def texts_of(channel: Channel, field_path: str, block: MessageBlock) -> Iterator[tuple[Intp, str]]:
    """Yield the texts in a field, each with its messages; damaged messages have none."""
    *above, name = key_path_of(field_path) or ("",)
    parse = partial(_parsed, _message_class(channel.type_name, channel.schema))

    def read(raw: bytes) -> tuple[Any, str]:
        message = parse(raw)
        return message, str(getattr(reduce(getattr, map(str, above), message), str(name)))

    others = np.ones(len(block), np.bool_)
    for text, _, taken, _ in _alike([block], read, others):
        yield taken, text  # texts are among what they have in common
    rest = np.flatnonzero(others)
    for row, raw in zip(rest.tolist(), raw_messages(block.at(rest)), strict=True):
        with suppress(*_MISFITS):
            yield np.array([row]), read(raw)[1]


def _alike(
    blocks: Paths[MessageBlock], read: Callable[[bytes], tuple[Any, Values]], others: Bool
) -> Iterator[tuple[Values, ProtobufLayout, Intp, NDArray[np.uint8]]]:
    """Yield what is read of the first of messages that share a layout, with these.

    `read`: returns a message, and what is wanted of it
    `others`: which messages are not yielded: those of rare or no layouts, shape ``(N,)``
    """
    lengths = np.concatenate([block.ends - block.starts for block in blocks])
    for length in _common_lengths(lengths):
        rest = np.flatnonzero(lengths == length)
        messages = _bytes_of(blocks, rest)
        while len(rest) >= _FEW:
            raw = messages[0].tobytes()
            try:
                message, values = read(raw)
                layout = ProtobufLayout(raw, message.DESCRIPTOR)
            except _MISFITS:
                break
            alike = layout.is_shared_by(messages)
            others[rest[alike]] = False
            yield values, layout, rest[alike], messages[alike]
            if np.count_nonzero(alike) < _FEW:
                break
            messages, rest = messages[~alike], rest[~alike]


def _common_lengths(lengths: Int64) -> list[int]:
    """Return the lengths of messages that are decoded by their layouts."""
    pairs = zip(*map(np.ndarray.tolist, np.unique(lengths, return_counts=True)), strict=True)
    return [length for length, count in pairs if count >= _FEW and 0 < length <= _LONGEST]


def _bytes_of(blocks: Paths[MessageBlock], positions: Intp) -> NDArray[np.uint8]:
    """Return the bytes of messages of one length, shape ``(N, length)``."""
    own = MessageBytes.of(take_messages(blocks, positions), "<", 0)
    return own.window(Window(0, own.shortest, ()), 0).view(np.uint8).reshape(len(own), -1)
