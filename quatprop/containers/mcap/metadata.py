"""The metadata records of an MCAP file that tell how its topics came about."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mcap.records import Metadata

from quatprop.containers.mcap.regions import RECORD
from quatprop.containers.mcap.summary import MALFORMED, RecordStream

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.containers.file_source import FileSource

_METADATA = 12
_LARGEST = 1 << 24


def read_provenance(source: FileSource, offsets: Iterable[int]) -> dict[str, str]:
    """Return the provenance of each topic, as JSON; under ``""`` that of all others.

    Parameters
    ----------
    source
        The file.
    offsets
        Where its metadata records with provenance begin.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    entries = [_read(source, offset) for offset in offsets]
    return {
        entry.get("topic", ""): entry["provenance"] for entry in entries if "provenance" in entry
    }


def _read(source: FileSource, offset: int) -> dict[str, str]:
    """Return the entries of one record; none where it is damaged."""
    head = source.read(offset, RECORD.size)
    if len(head) < RECORD.size:
        return {}
    opcode, length = RECORD.unpack(head)
    if opcode != _METADATA or length > _LARGEST:
        return {}
    try:
        record = Metadata.read(RecordStream(source.read(offset + RECORD.size, length)))
    except MALFORMED:
        return {}
    entries: dict[str, str] = record.metadata
    return entries
