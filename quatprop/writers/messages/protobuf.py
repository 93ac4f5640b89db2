"""The parts of protobuf that messages and their descriptors need, without its library.

The library is an optional dependency, and descriptors are messages of only a few kinds of
fields. The tests compare the bytes with the library's.

References
----------
The protobuf guides "Encoding" and "Language guide (proto 3)", and ``descriptor.proto``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

VARINT, FIXED64, LENGTH = 0, 1, 2
"""Wire types: a number of 7 bits a byte, eight bytes, or bytes after their length."""

_TYPES = {"double": 1, "int64": 3, "int32": 5, "string": 9}
_MESSAGE = 11
_OPTIONAL = 1
"""Numbers in ``descriptor.proto``: of types, and of the label of a field that is not a list."""


class ProtoFile(NamedTuple):
    """A file of definitions in proto 3.

    Parameters
    ----------
    package
        What its types are in.
    imports
        Names of the files that define what it uses.
    messages
        Types by name: their fields in order, numbered from 1, with a scalar type or, after a dot,
        the full name of a message.
    """

    package: str
    imports: tuple[str, ...]
    messages: Mapping[str, Mapping[str, str]]


def varint(number: int) -> bytes:
    """Return a number that is not negative, seven bits a byte, the lowest first.

    Examples
    --------
    >>> varint(300).hex()
    'ac02'
    """
    parts = []
    while number > 0x7F:  # noqa: PLR2004  # what fits seven bits
        parts.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*parts, number])


def tag(number: int, wire: int) -> bytes:
    """Return the tag that a field begins with."""
    return varint(number << 3 | wire)


def delimited(number: int, content: bytes | str) -> bytes:
    """Return a field of bytes, text, or a message in a message.

    Examples
    --------
    >>> delimited(2, "map").hex()
    '12036d6170'
    """
    data = content.encode() if isinstance(content, str) else content
    return tag(number, LENGTH) + varint(len(data)) + data


def described(files: Mapping[str, ProtoFile]) -> bytes:
    """Return a ``FileDescriptorSet``, the form of a schema in MCAP.

    Parameters
    ----------
    files
        By name, each after those that it imports.
    """
    return b"".join(delimited(1, _file(name, file)) for name, file in files.items())


def _file(name: str, file: ProtoFile) -> bytes:
    parts = [delimited(1, name), delimited(2, file.package)]
    parts += [delimited(3, imported) for imported in file.imports]
    parts += [delimited(4, _message(*message)) for message in file.messages.items()]
    return b"".join([*parts, delimited(12, "proto3")])


def _message(name: str, fields: Mapping[str, str]) -> bytes:
    numbered: Iterable[tuple[int, tuple[str, str]]] = enumerate(fields.items(), 1)
    parts = (delimited(2, _field(*field, number)) for number, field in numbered)
    return delimited(1, name) + b"".join(parts)


def _field(name: str, kind: str, number: int) -> bytes:
    parts = [
        delimited(1, name),
        tag(3, VARINT) + varint(number),
        tag(4, VARINT) + varint(_OPTIONAL),
        tag(5, VARINT) + varint(_TYPES.get(kind, _MESSAGE)),
    ]
    return b"".join(parts if kind in _TYPES else [*parts, delimited(6, kind)])
