"""The layout of a protobuf message: where its numbers are, and what other messages share it.

Written by hand because the library gives one value of one message at a time. It still reads one
message of each layout, and judges it; only the numbers of others like it are taken from the bytes.

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
    from quatprop.messages.schema import Steps

_VARINT, _EIGHT_BYTES, _LENGTH, _FOUR_BYTES = 0, 1, 2, 5
_WIRES = {
    **dict.fromkeys((1, 6, 16), _EIGHT_BYTES),
    **dict.fromkeys((2, 7, 15), _FOUR_BYTES),
    # Not enums: unknown values of some are no values.
    **dict.fromkeys((3, 4, 5, 8, 13, 17, 18), _VARINT),
    **dict.fromkeys((11, 12), _LENGTH),
}
"""How values are encoded, by the type of a field; of others, every byte counts."""

_MESSAGE, _ZIGZAG = 11, (17, 18)
_EVERY_BIT, _CONTINUES = 0xFF, 0x80
_LONGEST_VARINT = 10


class Place(NamedTuple):
    """Where a value is, and the type of its field."""

    begin: int
    end: int
    kind: int


class ProtobufLayout:
    """The layout of a message that the library has read.

    `places`: where the numbers are that are set, by their ways

    Raises LookupError where a message has a group, or twice what it has once.
    """

    def __init__(self, raw: bytes, message: Any) -> None:
        self.places: dict[Steps, Place] = {}
        self._raw = np.frombuffer(raw, np.uint8)
        # All that another message must have in common: tags, lengths and texts.
        self._common = np.full(len(raw), _EVERY_BIT, np.uint8)
        self._walk(0, len(raw), message, ())

    def shared_by(self, messages: NDArray[np.uint8]) -> Bool:
        """Return which messages of the same length have this layout, shape ``(N,)``.

        `messages`: their bytes, shape ``(N, length)``
        """
        at = np.flatnonzero(self._common)
        differs = (messages[:, at] ^ self._raw[at]) & self._common[at]
        alike: Bool = np.logical_not(differs.any(axis=1))
        return alike

    def numbers(self, messages: NDArray[np.uint8], way: Steps, code: str) -> AnyArray:
        """Return a number of each message of this layout, shape ``(N,)``.

        `code`: NumPy's, of the number
        """
        begin, end, kind = self.places[way]
        values: AnyArray
        if _WIRES[kind] != _VARINT:
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
        # Numbers of fewer bits are cut; a truth value is whether there is any.
        numbers: AnyArray = values.astype(code)
        return numbers

    def _walk(self, at: int, end: int, message: Any, way: Steps | None) -> None:
        """Note the values in a part of the message; `way` is None in what is repeated."""
        names: set[str] = set()
        while at < end:
            tag, at = self._varint(at)
            begin, at = self._value(at, tag & 7)
            field = message.fields_by_number.get(tag >> 3)
            if field is None:
                continue
            if not field.is_repeated:
                # Of several that exclude each other the last one counts; messages are merged.
                name = (field.containing_oneof or field).full_name
                if name in names:
                    raise LookupError(name)
                names.add(name)
            if _WIRES.get(field.type) == tag & 7:
                inner = None if way is None or field.is_repeated else (*way, field.name)
                self._note(Place(begin, at, field.type), field, inner)
            elif field.is_repeated and _WIRES.get(field.type) in {_EIGHT_BYTES, _FOUR_BYTES}:
                self._common[begin:at] = 0  # packed

    def _note(self, place: Place, field: Any, way: Steps | None) -> None:
        """Note where a value is, and which of its bits may differ."""
        begin, end, kind = place
        if kind == _MESSAGE:
            self._walk(begin, end, field.message_type, way)
            return
        if _WIRES[kind] == _VARINT:
            # Of the last byte of the longest ones only one bit is of the number.
            self._common[begin : min(end, begin + _LONGEST_VARINT - 1)] = _CONTINUES
        else:
            self._common[begin:end] = 0
        if way is not None:
            self.places[way] = place

    def _value(self, at: int, wire: int) -> tuple[int, int]:
        """Return where a value begins and ends; it has a number or a length before it."""
        value, end = self._varint(at) if wire in {_VARINT, _LENGTH} else (0, at)
        if wire == _VARINT:
            return at, end
        sizes = {_EIGHT_BYTES: 8, _FOUR_BYTES: 4, _LENGTH: value}
        return end, end + sizes[wire]

    def _varint(self, at: int) -> tuple[int, int]:
        """Return the number at a place, and where it ends."""
        value = shift = 0
        while True:
            byte = int(self._raw[at])
            value |= (byte & ~_CONTINUES) << shift
            at, shift = at + 1, shift + 7
            if byte < _CONTINUES:
                return value, at
