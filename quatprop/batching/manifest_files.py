"""The files of a manifest, and which of their entries are looked at together."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, NamedTuple

from quatprop.batching.entries import BUCKETS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

PART = ".pq"
"""Suffix of a part in Parquet: not that of outputs, which ``DIR/**/*.parquet`` stands for."""

LINES = ".jsonl"

ENTRY_BYTES = {PART: 32, LINES: 256}
"""Bytes of an entry, at least."""

SLICE_ROWS = 1 << 18
"""Entries that are looked at together, at most."""


class ManifestFile(NamedTuple):
    """Name, size and time, s, of a file of a manifest."""

    name: str
    size: int
    written: float

    @property
    def rows(self) -> int:
        """Its entries, at most."""
        return self.size // ENTRY_BYTES[PurePath(self.name).suffix]


def is_own(name: str) -> bool:
    """Return whether a file is a part or has lines, and is not being written."""
    return name.endswith((PART, LINES)) and not name.startswith(".")


def slices(files: Sequence[ManifestFile]) -> Iterator[range]:
    """Yield ranges of buckets, of which the entries are few enough to be looked at together."""
    count = min(BUCKETS, sum(file.rows for file in files) // SLICE_ROWS + 1)
    for number in range(count):
        yield range(number * BUCKETS // count, (number + 1) * BUCKETS // count)


def groups(files: Sequence[ManifestFile]) -> Iterator[list[str]]:
    """Yield names of files whose entries are few enough to be looked at together."""
    names: list[str] = []
    rows = 0
    for file in files:
        if names and rows + file.rows > SLICE_ROWS:
            yield names
            names, rows = [], 0
        names.append(file.name)
        rows += file.rows
    if names:
        yield names
