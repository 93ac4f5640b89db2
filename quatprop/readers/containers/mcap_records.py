"""Channel, schema and metadata records of an MCAP file.

Importing the mcap library would take longer than propagating a small log.
"""

from __future__ import annotations

import struct
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.stores.compression import Buffer

MALFORMED = (ValueError, struct.error)
"""Exceptions that damaged records raise."""


class SchemaRecord(NamedTuple):
    """A schema, with the fields of ``mcap.records.Schema``."""

    id: int
    name: str
    encoding: str
    data: bytes

    @property
    def identity(self) -> tuple[str, str, bytes]:
        """Name, encoding and text: schemas with the same identity are equal."""
        return self.name, self.encoding, self.data


class ChannelRecord(NamedTuple):
    """A channel, with the fields of ``mcap.records.Channel``."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str]

    @property
    def identity(self) -> tuple[str, str, int]:
        """Topic, encoding and schema: channels with the same identity are equal."""
        return self.topic, self.message_encoding, self.schema_id


def read_schema(content: Buffer) -> SchemaRecord:
    """Return a schema from the content of its record."""
    (id_,) = struct.unpack_from("<H", content)
    name, encoding, data = prefixed(content, 2, 3)
    rest = bytes(content[2 + 3 * 4 + len(name) + len(encoding) + len(data) :])
    if rest.isascii() and rest.decode().strip().isprintable() and rest.strip():
        raise ValueError  # text behind the definition: its length is damaged
    return SchemaRecord(id_, name.decode(), encoding.decode(), data)


def read_channel(content: Buffer) -> ChannelRecord:
    """Return a channel from the content of its record."""
    id_, schema_id = struct.unpack_from("<HH", content)
    topic, encoding, metadata = prefixed(content, 4, 3)
    return ChannelRecord(id_, schema_id, topic.decode(), encoding.decode(), _mapping(metadata))


def read_metadata(content: Buffer) -> tuple[str, dict[str, str]]:
    """Return the name and entries of a metadata record."""
    name, entries = prefixed(content, 0, 2)
    return name.decode(), _mapping(entries)


def prefixed(content: Buffer, begin: int, count: int) -> list[bytes]:
    """Return the first `count` length-prefixed values of a record, from an offset on."""
    parts = list(islice(_parts(content, begin), count))
    if len(parts) < count:
        raise ValueError
    return parts


def _mapping(data: bytes) -> dict[str, str]:
    parts = [part.decode() for part in _parts(data, 0)]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def _parts(content: Buffer, begin: int) -> Iterator[bytes]:
    while begin < len(content):
        (length,) = struct.unpack_from("<I", content, begin)
        begin += 4 + length
        if begin > len(content):
            raise ValueError
        yield bytes(content[begin - length : begin])
