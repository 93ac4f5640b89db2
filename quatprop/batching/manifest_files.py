"""The files of a manifest, and which of their entries are looked at together."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.batching.entries import BUCKETS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

PART = ".pq"
"""Suffix of a part in Parquet: not that of outputs, which ``DIR/**/*.parquet`` stands for."""

LINES = ".jsonl"

LINE_BYTES = 256
"""Bytes of an entry in a file with lines, at least."""

SLICE_ROWS = 1 << 15
"""Entries that are looked at together, about."""


class ManifestFile(NamedTuple):
    """Name, size and time, s, of a file of a manifest."""

    name: str
    size: int
    written: float


def is_own(name: str) -> bool:
    """Return whether a file is a part or has lines, and is not being written."""
    return name.endswith((PART, LINES)) and not name.startswith(".")


def slices(rows: int) -> Iterator[range]:
    """Yield ranges of buckets, of which the entries are few enough to be looked at together."""
    count = min(BUCKETS, rows // SLICE_ROWS + 1)
    for number in range(count):
        yield range(number * BUCKETS // count, (number + 1) * BUCKETS // count)


def groups(files: Sequence[ManifestFile]) -> Iterator[list[str]]:
    """Yield names of files with lines, few enough to be looked at together."""
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
