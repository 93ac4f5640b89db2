"""The records of an MCAP file that name things: channels, schemas and metadata.

Read without the mcap library, which takes longer to be imported than a small log to be propagated.
"""

from __future__ import annotations

import struct
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.stores.compression import Buffer

MALFORMED = (ValueError, struct.error)
"""Exceptions that are raised when a damaged record is read."""


class SchemaRecord(NamedTuple):
    """A schema, with the fields of ``mcap.records.Schema``."""

    id: int
    name: str
    encoding: str
    data: bytes

    @property
    def identity(self) -> tuple[str, str, bytes]:
        """What makes it another schema: name, encoding and text."""
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
        """What makes it another channel: topic, encoding and schema."""
        return self.topic, self.message_encoding, self.schema_id


def read_schema(content: Buffer) -> SchemaRecord:
    """Return a schema from the content of its record."""
    (id_,) = struct.unpack_from("<H", content)
    name, encoding, data = prefixed(content, 2, 3)
    rest = bytes(content[2 + 3 * 4 + len(name) + len(encoding) + len(data) :])
    if rest.isascii() and rest.decode().strip().isprintable() and rest.strip():
        raise ValueError  # more of the definition, whose length is damaged, and no new field
    return SchemaRecord(id_, name.decode(), encoding.decode(), data)


def read_channel(content: Buffer) -> ChannelRecord:
    """Return a channel from the content of its record."""
    id_, schema_id = struct.unpack_from("<HH", content)
    topic, encoding, metadata = prefixed(content, 4, 3)
    return ChannelRecord(id_, schema_id, topic.decode(), encoding.decode(), _mapping(metadata))


def read_metadata(content: Buffer) -> tuple[str, dict[str, str]]:
    """Return name and entries of a metadata record."""
    name, entries = prefixed(content, 0, 2)
    return name.decode(), _mapping(entries)


def prefixed(content: Buffer, begin: int, count: int) -> list[bytes]:
    """Return parts of a record that stand behind their lengths, from an offset on."""
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
