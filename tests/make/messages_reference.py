"""An encoder written straight from the rules of the encodings, one value after another.

It shares nothing with the code under test but the types that describe a message.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.readers.messages.blocks import Channel, MessageBlock
from quatprop.readers.messages.schema import Array, Primitive, Sequence, String, Struct, key_path_of

if TYPE_CHECKING:
    from random import Random

NAMES = {
    code: np.dtype(code).name
    for code in ("b1", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")
}
HEADERS = {
    ("ros1", "<", 1): b"",
    ("cdr", ">", 8): b"\0\0\0\0",
    ("cdr", "<", 8): b"\0\1\0\0",
    ("cdr", ">", 4): b"\0\6\0\0",
    ("cdr", "<", 4): b"\0\7\0\0",
}


@dataclass
class Encoder:
    """Bytes of one message; alignment counts from the end of the header."""

    encoding: str
    order: str
    largest: int
    out: bytearray = field(default_factory=bytearray)

    def message(self, kind, value):
        """Return the bytes of a whole message."""
        self.value(kind, value)
        return HEADERS[self.encoding, self.order, self.largest] + bytes(self.out)

    def number(self, code, value):
        """Write a number at the next multiple of its size."""
        size = int(code[1:])
        self.out += bytes(-len(self.out) % min(size, self.largest))
        self.out += np.array(value, self.order + code).tobytes()

    def value(self, kind, value):
        """Write any value."""
        if isinstance(kind, Primitive):
            self.number(kind.code, value)
        elif isinstance(kind, String):
            encoded = value.encode() + (b"" if self.encoding == "ros1" else b"\0")
            self.number("u4", len(encoded))
            self.out += encoded
        elif isinstance(kind, Struct):
            for name, part in kind.fields:
                self.value(part, value[name])
        else:
            if isinstance(kind, Sequence):
                self.number("u4", len(value))
            for item in value:
                self.value(kind.element, item)


def random_value(kind, source: Random, longest=3) -> Any:
    """Return a random value of a type; strings and sequences have up to `longest` elements."""
    if isinstance(kind, Primitive):
        return _random_number(kind.code, source)
    if isinstance(kind, String):
        return "".join(source.choices("abcdefgh", k=source.randint(0, 3 * longest)))
    if isinstance(kind, Struct):
        return {name: random_value(part, source, longest) for name, part in kind.fields}
    length = kind.length if isinstance(kind, Array) else source.randint(0, longest)
    return [random_value(kind.element, source, longest) for _ in range(length)]


def _random_number(code, source):
    size = int(code[1:])
    if code == "b1":
        return source.random() < 0.5
    if code[0] == "f":
        return float(np.array(source.gauss(0, 9), code))
    low = -(1 << (8 * size - 1)) if code[0] == "i" else 0
    return source.randrange(low, low + (1 << (8 * size)))


def look_up(value, field_path):
    """Return what a dotted path leads to, rows of numbers flattened."""
    for key in key_path_of(field_path):
        value = value[key]
    return flat(value)


def flat(value):
    """Return the numbers in a value, in order."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        # Python's own numbers: an array of integers below and above 2**63 would be of floats.
        parts = [flat(item) for item in value]
        return [one for part in parts for one in (part if isinstance(part, list) else [part])]
    return value


def definition(root: Struct) -> str:
    """Return a type as a .msg definition with the types inside it."""
    inside: dict[str, Struct] = {}
    text = _lines(root, inside)
    for name in (names := list(inside)):
        text += "=" * 80 + f"\nMSG: {name}\n" + _lines(inside[name], inside)
        names += [new for new in inside if new not in names]
    return text


def _lines(kind: Struct, inside: dict[str, Struct]) -> str:
    return "".join(f"{_spelled(part, inside)} {name}\n" for name, part in kind.fields)


def _spelled(kind, inside):
    if isinstance(kind, Primitive):
        return NAMES[kind.code]
    if isinstance(kind, String):
        return "string"
    if isinstance(kind, Struct):
        inside[kind.name] = kind
        return kind.name
    length = kind.length if isinstance(kind, Array) else ""
    return f"{_spelled(kind.element, inside)}[{length}]"


def channel_of(kind: Struct | str, encoding: str) -> Channel:
    """Return a channel that carries a definition, of a type or as it is."""
    grammar = "ros1msg" if encoding == "ros1" else "ros2msg"
    name, text = ("pkg/msg/T", kind) if isinstance(kind, str) else (kind.name, definition(kind))
    return Channel("/topic", name, encoding, grammar, text.encode())


def block_of(messages: list[bytes], gap=lambda _position: 0) -> MessageBlock:
    """Return messages in one buffer with bytes of 0xEE between them."""
    data, starts = bytearray(), []
    for position, message in enumerate(messages):
        data += b"\xee" * gap(position)
        starts.append(len(data))
        data += message
    begin = np.array(starts, np.int64)
    ends = begin + np.array([len(message) for message in messages], np.int64)
    stamps = np.arange(len(messages), dtype=np.int64) * 1000
    return MessageBlock(np.frombuffer(bytes(data), np.uint8), begin, ends, stamps, stamps)
