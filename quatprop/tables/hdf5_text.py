"""Read variable-length strings in HDF5 attributes without the library.

They are in a heap of the file; if it is damaged, the library hangs or crashes.

References
----------
The HDF Group, "HDF5 File Format Specification", III.E "Global Heap", IV.A.1 "Object Headers",
IV.A.2.m "The Attribute Message" and IV.A.2.q "The Object Header Continuation Message".
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from collections.abc import Iterator

_MOST_BYTES = 1 << 20
_MOST_BLOCKS = 64
_ATTRIBUTE, _CONTINUATION = 0x0C, 0x10
_IS_SHARED, _HAS_TIMES, _HAS_PHASES, _HAS_ORDER = 2, 0x20, 0x10, 4
_REFERENCE = struct.Struct("<IQI")
_HEAP_OBJECT = struct.Struct("<HHIQ")
_OLD_ATTRIBUTE, _NEW_ATTRIBUTE = 1, 3


def variable_text(file: BinaryIO, base: int, address: int, name: str) -> list[str] | None:
    """Return the strings of an attribute; None if they cannot be read."""
    try:
        for message in _attributes(file, base, address):
            found, data = _name_and_data(message)
            if found == name.encode():
                count = len(data) // _REFERENCE.size
                places = _REFERENCE.iter_unpack(data[: count * _REFERENCE.size])
                texts = [_heap_text(file, base, *place) for place in places]
                return [text.decode(errors="replace") for text in texts]
    except (struct.error, OSError, OverflowError, LookupError):
        return None
    return None


def _at(file: BinaryIO, place: int, size: int) -> bytes:
    file.seek(place)
    return file.read(min(size, _MOST_BYTES))


def _attributes(file: BinaryIO, base: int, address: int) -> Iterator[bytes]:
    """Yield the attribute messages of an object header."""
    head = _at(file, base + address, 64)
    is_new = head.startswith(b"OHDR")
    if is_new:
        flags = head[5]
        begin = 6 + (16 if flags & _HAS_TIMES else 0) + (4 if flags & _HAS_PHASES else 0)
        width = 1 << (flags & 3)
        size = int.from_bytes(head[begin : begin + width], "little")
        begin += width
        message_head = struct.Struct("<BHBxx" if flags & _HAS_ORDER else "<BHB")
    else:
        begin, size = 16, struct.unpack_from("<I", head, 8)[0]
        message_head = struct.Struct("<HHBxxx")
    blocks = [(base + address + begin, size)]
    for block in blocks:
        data = _at(file, *block)
        if is_new and block is not blocks[0]:
            data = data[4:-4]  # between a signature and a checksum
        at = 0
        while at + message_head.size <= len(data):
            kind, length, flags = message_head.unpack_from(data, at)
            at += message_head.size
            content = data[at : at + length]
            at += length
            if kind == _ATTRIBUTE and not flags & _IS_SHARED:
                yield content
            elif kind == _CONTINUATION and len(blocks) < _MOST_BLOCKS:
                offset, size = struct.unpack_from("<QQ", content)
                blocks.append((base + offset, size))


def _name_and_data(message: bytes) -> tuple[bytes, bytes]:
    version, _, *sizes = struct.unpack_from("<BBHHH", message)
    begin = 9 if version == _NEW_ATTRIBUTE else 8
    name = message[begin : begin + sizes[0]].rstrip(b"\0")
    step = 8 if version == _OLD_ATTRIBUTE else 1
    return name, message[begin + sum(-(-size // step) * step for size in sizes) :]


def _heap_text(file: BinaryIO, base: int, length: int, heap: int, number: int) -> bytes:
    """Return a string by its length, the address of its heap, and its index in the heap."""
    if not length:
        return b""
    (size,) = struct.unpack_from("<8xQ", _at(file, base + heap, 16))
    data = _at(file, base + heap, size)
    at = 16
    while data.startswith(b"GCOL"):
        found, _, _, size = _HEAP_OBJECT.unpack_from(data, at)
        at += _HEAP_OBJECT.size
        if found == number and length <= size <= len(data) - at:
            return data[at : at + length]
        at += -(-size // 8) * 8
    raise LookupError
