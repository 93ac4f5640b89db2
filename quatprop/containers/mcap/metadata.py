"""The metadata records of an MCAP file that tell how its topics came about."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.mcap.records import MALFORMED, read_metadata
from quatprop.containers.mcap.regions import RECORD

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
        return read_metadata(source.read(offset + RECORD.size, length))[1]
    except MALFORMED:
        return {}
