"""What the metadata records of an MCAP file say about how its topics came about."""

from __future__ import annotations

import struct
from io import BytesIO
from typing import TYPE_CHECKING

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from quatprop.containers.mcap.regions import RECORD
from quatprop.containers.mcap.summary import read_footer
from quatprop.provenance import METADATA_KEY

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.file_source import FileSource

_METADATA, _METADATA_INDEX = 12, 13
_LARGEST = 1 << 24
_DAMAGE = (McapError, struct.error, ValueError)


def recorded_provenance(source: FileSource) -> dict[str, str]:
    """Return the provenance of each topic, as JSON; under ``""`` that of all others.

    They are found through the summary: a file that was cut off before it says nothing.

    Parameters
    ----------
    source
        The file.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    records = [_read(source, place) for place in _places(source)]
    return {one.get("topic", ""): one["provenance"] for one in records if "provenance" in one}


def _places(source: FileSource) -> Iterator[int]:
    """Yield where the records of this package are, by the index of the summary."""
    footer = read_footer(source)
    if footer is None or not 0 < footer.footer_start - footer.summary_start <= _LARGEST:
        return
    data = source.read(footer.summary_start, footer.footer_start - footer.summary_start)
    position = 0
    while position + RECORD.size <= len(data):
        opcode, length = RECORD.unpack_from(data, position)
        position += RECORD.size
        if opcode == _METADATA_INDEX and length <= len(data) - position:
            try:
                index = records.MetadataIndex.read(_stream(data[position : position + length]))
            except _DAMAGE:
                return
            if index.name == METADATA_KEY.decode():
                yield index.offset
        position += length


def _read(source: FileSource, place: int) -> dict[str, str]:
    """Return what one record says; nothing where it is damaged."""
    head = source.read(place, RECORD.size)
    if len(head) < RECORD.size:
        return {}
    opcode, length = RECORD.unpack(head)
    if opcode != _METADATA or length > _LARGEST:
        return {}
    try:
        record = records.Metadata.read(_stream(source.read(place + RECORD.size, length)))
    except _DAMAGE:
        return {}
    said: dict[str, str] = record.metadata
    return said


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
