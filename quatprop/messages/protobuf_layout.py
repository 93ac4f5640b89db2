"""The layout of a protobuf message: the offsets of its numbers, shared by similar messages.

Written by hand because the library returns one value of one message at a time. It still decodes and
checks one message of each layout; of the others, only the numbers are read from the bytes.

References
----------
Protocol Buffers Documentation, "Encoding".
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from quatprop.arrays import AnyArray, Bool
    from quatprop.messages.schema import KeyPath

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
