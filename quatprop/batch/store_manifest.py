"""The manifest of a batch whose outputs are in an object store, where nothing can be appended to.

Each process that records entries has an object of its own below ``manifest/``, which it writes
again with each entry, and begins another one before it becomes large. ``manifest.jsonl`` and its
table are made of all of them at the end of a batch.
"""

from __future__ import annotations

import os
import secrets
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from quatprop.batch.entries import ManifestEntry, entries_in, json_line
from quatprop.batch.manifest import Manifest, write_table
from quatprop.stores.objects import below, is_address, list_objects, without_secret
from quatprop.stores.transfers import get, put, upload

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping


PART_ENTRIES = 100
"""Entries of an object: writing it again must stay cheap."""

REQUESTS = 16
"""Objects that are read at a time."""


class StoreManifest(Manifest):
    """The manifest of a batch whose outputs are in an object store.

    `folder`: address of the prefix of all outputs
    """

    def __init__(self, folder: str) -> None:
        self._folder = folder
        self.files = ()
        self.place, self.unused = without_secret(below(folder, self.NAME)), []
        self._part = ""
        self._lines: list[bytes] = []

    def prepare(self) -> None:
        """Find out whether objects may be written, before anything is computed."""
        put(self._new_part(), b"")

    def existing_outputs(self) -> Callable[[str], bool]:
        """Return a function that tells whether an output is there, by its path in the folder."""
        names = set(list_objects(self._folder, missing_ok=True))
        # An output may be a folder.
        names |= {name.rpartition("/")[0] for name in names}
        return names.__contains__

    def record(self, entry: ManifestEntry) -> None:
        """Record an entry."""
        if not self._part or len(self._lines) == PART_ENTRIES:
            self._part, self._lines = self._new_part(), []
        self._lines.append(json_line(entry))
        put(self._part, b"".join(self._lines))

    def write_table(self) -> None:
        """Write all entries as ``manifest.jsonl``, and as ``manifest.parquet``.

        Other batches may record entries meanwhile, and write these files as well: whoever is last
        has all entries.
        """
        parts = self._parts()
        while True:
            entries = sorted(self.entries().items())
            with tempfile.TemporaryDirectory(prefix="quatprop-") as folder:
                table = Path(folder, "manifest.parquet")
                write_table((entry for _, entry in entries), table)
                upload(table, below(self._folder, table.name))
            lines = b"".join(json_line(entry) for _, entry in entries)
            put(below(self._folder, self.NAME), lines)
            before, parts = parts, self._parts()
            if parts == before:
                return

    def _read(self) -> Iterator[Mapping[str, Any]]:
        """Yield all entries, the oldest first."""
        objects = list_objects(self._folder, missing_ok=True)
        names = [name for name, info in objects.items() if info.size]
        whole = [name for name in names if name == self.NAME]
        parts = [name for name in names if name.startswith("manifest/")]
        with ThreadPoolExecutor(REQUESTS) as pool:
            addresses = [below(self._folder, name) for name in whole + parts]
            for content in pool.map(get, addresses):
                yield from entries_in(content.splitlines(), self.unused)

    def _parts(self) -> list[tuple[str, int]]:
        objects = list_objects(below(self._folder, "manifest"), missing_ok=True)
        return [(name, info.size) for name, info in objects.items()]

    def _new_part(self) -> str:
        name = f"{time.time_ns():020d}-{os.getpid()}-{secrets.token_hex(4)}.jsonl"
        return below(self._folder, f"manifest/{name}")


def manifest_in(folder: str) -> Manifest:
    """Return the manifest of a batch, by the folder or the address of its outputs."""
    return StoreManifest(folder) if is_address(folder) else Manifest(folder)


def without_file_scheme(folder: str) -> str:
    """Return an address of this machine, ``file://``, as a path; others as they are."""
    parts = urlsplit(folder)
    return url2pathname(parts.path) if parts.scheme == "file" else folder
