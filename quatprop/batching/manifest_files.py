"""The files of a manifest, and how their entries are grouped for reading."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.batching.entries import BUCKETS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

PART = ".pq"
"""Suffix of a Parquet part, which ``DIR/**/*.parquet`` does not match."""

LINES = ".jsonl"

LINE_BYTES = 256
"""Minimum size of an entry in a file of lines, bytes."""

SLICE_ROWS = 1 << 15
"""Approximate number of entries read at once."""


class ManifestFile(NamedTuple):
    """Name, size and time, s, of a file of a manifest."""

    name: str
    size: int
    written: float


def is_own(name: str) -> bool:
    """Return whether a file is a complete part or file of lines."""
    return name.endswith((PART, LINES)) and not name.startswith(".")


def slices(rows: int) -> Iterator[range]:
    """Yield ranges of buckets with few enough entries to be read at once."""
    count = min(BUCKETS, rows // SLICE_ROWS + 1)
    for number in range(count):
        yield range(number * BUCKETS // count, (number + 1) * BUCKETS // count)


def groups(files: Sequence[ManifestFile]) -> Iterator[list[str]]:
    """Yield groups of files of lines, small enough to be read at once."""
    names: list[str] = []
    size = 0
    for file in files:
        if names and size + file.size > SLICE_ROWS * LINE_BYTES:
            yield names
            names, size = [], 0
        names.append(file.name)
        size += file.size
    if names:
        yield names
