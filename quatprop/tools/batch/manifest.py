"""The manifest of a batch: the result of each log, in ``DIR/_manifest/``.

Entries are never changed, so that any number of batches may write to one folder or store prefix at
once, and may be killed at any time. Each process appends its results to its own file, as lines of
JSON. At its end, a batch merges its files into one Parquet part. Many parts of similar size are
merged, so that the time per log does not grow with the number of logs. The latest entry for an
output is the valid one.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.batching.entries import BUCKETS, TYPES, distinct, json_line, schema, table_of
from quatprop.batching.logs import place_below
from quatprop.batching.manifest_files import (
    LINE_BYTES,
    LINES,
    PART,
    ManifestFile,
    groups,
    is_own,
    slices,
)
from quatprop.errors import OutputError, StoreError
from quatprop.stores.objects import is_address, list_objects, locate, without_secret
from quatprop.stores.transfers import get, put
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import output_errors, refuse_outside

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import pyarrow as pa
    import pyarrow.dataset as ds

    from quatprop.batching.entries import ManifestEntry

FOLDER = "_manifest"
"""Readers of datasets skip names that begin with an underscore."""

OBJECT_ENTRIES = 100
"""Maximum number of entries of an object of lines, which is rewritten for each entry."""

FILE_ENTRIES = 1 << 14
"""Maximum number of entries of a file of lines, which is parsed at once."""

REQUESTS = 16
"""Number of objects read at a time."""

SIMILAR = 4
"""Parts are similar if the bit lengths of their sizes are equal after division by this."""

MANY = 16
"""Number of similar parts from which they are merged."""

ABANDONED_S = 7 * 86_400
"""Age of files of lines, s, from which they are considered abandoned."""


def new_run() -> str:
    """Return a name for a batch, with its start time."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}-{secrets.token_hex(4)}"


class _MergedError(Exception):
    """A file no longer exists, since another batch has just merged it."""


class Manifest:
    """The manifest in the folder, or below the address, of a batch's outputs.

    `run`: name of this batch
    `unused`: number of invalid lines in the last reading
    """

    def __init__(self, folder: str) -> None:
        self.folder, self.run, self.unused = folder, new_run(), 0
        self._recorded = 0
        self._place = place_below(folder, FOLDER)
        self.place = without_secret(self._place)
        self._is_remote = is_address(folder)
        self._lines: list[bytes] = []
        self._journal = ""
        if not self._is_remote:
            refuse_outside(self._place, folder)
            if Path(self._place).exists() and not Path(self._place).is_dir():
                raise OutputError(self._place, "is not a folder; remove it")

    def prepare(self) -> None:
        """Check that the manifest can be written."""
        if self._is_remote:
            put(self._new_name(LINES), b"")
            return
        with output_errors(self._place):
            Path(self._place).mkdir(parents=True, exist_ok=True)

    def record(self, entry: ManifestEntry) -> ManifestEntry:
        """Append an entry, and return it; after a failure, the next one begins a new file."""
        line = json_line(entry := entry.recorded(self.run))
        if self._is_remote:
            if not self._journal or len(self._lines) == OBJECT_ENTRIES:
                self._journal, self._lines = self._new_name(LINES), []
            self._lines.append(line)
            put(self._journal, b"".join(self._lines))
            return entry
        if self._recorded % FILE_ENTRIES == 0:
            self._journal = ""
        journal, self._journal = self._journal or self._new_name(LINES), ""
        with output_errors(self._place):
            file = os.open(journal, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
            try:
                if os.write(file, line) < len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            finally:
                os.close(file)
        self._journal, self._recorded = journal, self._recorded + 1
        return entry

    def __getstate__(self) -> dict[str, object]:
        """Return the state without the current file, so that each process has its own."""
        return {**self.__dict__, "_journal": "", "_lines": []}

    def slices(self, columns: Sequence[str]) -> Iterator[tuple[range, dict[str, tuple[Any, ...]]]]:
        """Yield ranges of buckets, and their valid entries: output -> values of columns."""
        for buckets in self._slices():
            wanted = list(dict.fromkeys(["output", "time", *columns]))
            table = self._read(buckets, wanted).sort_by("time")
            values = zip(*(table[name].to_pylist() for name in columns), strict=True)
            yield buckets, dict(zip(table["output"].to_pylist(), values, strict=True))

    def history(self) -> pa.Table:
        """Return all entries ever recorded, sorted by output and time."""
        return distinct(self._read(range(BUCKETS)), ["output", "time", "run"])

    def collect(self) -> None:
        """Merge the files of this batch, and those of killed batches, into parts."""
        limit = time.time() - ABANDONED_S
        own = [
            file
            for file in self._files()
            if file.name.endswith(LINES)
            and (file.name.startswith(self.run) or file.written < limit)
        ]
        for names in groups(own):
            self._merge(names)
        similar: dict[int, list[str]] = {}
        for file in self._files():
            if file.name.endswith(PART):
                similar.setdefault(file.size.bit_length() // SIMILAR, []).append(file.name)
        for names in similar.values():
            if len(names) >= MANY:
                self._merge(names)

    def _merge(self, names: list[str]) -> None:
        """Merge files into one part, sorted by bucket, and remove them.

        Concurrent readers may see an entry twice, which has no effect.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        with suppress(_MergedError):
            with (
                open_atomic(self._new_name(PART)) as stream,
                pq.ParquetWriter(stream, schema(), compression="zstd") as writer,
            ):
                for buckets in self._slices(names):
                    table = self._read(buckets, names=names)
                    table = distinct(table, ["bucket", "output", "time", "run"])
                    writer.write_table(table, row_group_size=1 << 14)
                    del table
                    pa.default_memory_pool().release_unused()
            # Removed last: a kill before must not lose entries.
            self._remove(names)

    def _remove(self, names: list[str]) -> None:
        for name in names:
            if self._is_remote:
                store, place = locate(place_below(self._place, name))
                with suppress(OSError):
                    store.delete_file(place)
            else:
                Path(self._place, name).unlink(missing_ok=True)

    def _files(self) -> list[ManifestFile]:
        """Return all files, the oldest first.

        They are listed again if one was removed meanwhile, since its replacement may be missing.
        """
        while True:
            with suppress(_MergedError):
                before, files = self._listed(), self._listed()
                if {file.name for file in before} <= {file.name for file in files}:
                    return files

    def _listed(self) -> list[ManifestFile]:
        if self._is_remote:
            objects = list_objects(self._place, missing_ok=True).items()
            found = [
                ManifestFile(name, info.size, (info.mtime_ns or 0) * 1e-9)
                for name, info in objects
                if is_own(name)
            ]
            return sorted(file for file in found if file.size)
        found = []
        with suppress(FileNotFoundError), os.scandir(self._place) as entries:
            for entry in entries:
                if is_own(entry.name):
                    try:
                        status = entry.stat()
                    except FileNotFoundError as error:
                        raise _MergedError from error
                    if stat.S_ISREG(status.st_mode):
                        found.append(ManifestFile(entry.name, status.st_size, status.st_mtime))
        return sorted(file for file in found if file.size)

    def _slices(self, names: Sequence[str] | None = None) -> Iterator[range]:
        """Return ranges of buckets of bounded size; `names`: files to read, None: all."""
        while True:
            with suppress(FileNotFoundError):  # another batch has just merged one of them
                files = [file for file in self._files() if names is None or file.name in names]
                lines = sum(file.size for file in files if file.name.endswith(LINES))
                parts = [file.name for file in files if file.name.endswith(PART)]
                rows = self._dataset(parts).count_rows() if parts else 0
                return slices(rows + lines // LINE_BYTES)

    def _dataset(self, parts: Sequence[str]) -> ds.Dataset:
        import pyarrow.dataset as ds

        store, place = locate(self._place) if self._is_remote else (None, self._place)
        paths = [f"{place}/{name}" for name in parts]
        return ds.dataset(paths, schema(), format="parquet", filesystem=store)

    def _read(
        self,
        buckets: range,
        columns: Sequence[str] | None = None,
        names: Sequence[str] | None = None,
    ) -> pa.Table:
        """Return entries, unsorted; `names`: files to read, None: all."""
        if names is not None:
            return self._read_files(names, buckets, columns)
        while True:
            with suppress(_MergedError):
                return self._read_files([file.name for file in self._files()], buckets, columns)

    def _read_files(
        self, names: Sequence[str], buckets: range, columns: Sequence[str] | None
    ) -> pa.Table:
        try:
            return self._tables(names, buckets, columns)
        except FileNotFoundError as error:
            raise _MergedError from error

    def _tables(
        self, names: Sequence[str], buckets: range, columns: Sequence[str] | None
    ) -> pa.Table:
        import pyarrow as pa
        import pyarrow.compute as pc

        columns = columns or list(TYPES)
        chosen = None
        if len(buckets) < BUCKETS:  # a comparison with a number imports pandas, 0.4 s
            bucket = pc.field("bucket")
            chosen = (bucket >= buckets.start) & (bucket < buckets.stop)
        lines = [name for name in names if name.endswith(LINES)]
        tables, self.unused = [], 0
        with ThreadPoolExecutor(REQUESTS) as pool:
            # Local files are large, and read one at a time.
            read = pool.map if self._is_remote else map
            for table, unused in map(table_of, read(self._content, lines)):
                tables.append((table if chosen is None else table.filter(chosen)).select(columns))
                self.unused += unused
        if parts := [name for name in names if name.endswith(PART)]:
            ahead = REQUESTS if self._is_remote else 1  # parts take memory
            data = self._dataset(parts)
            tables.append(data.to_table(columns, filter=chosen, fragment_readahead=ahead))
        return pa.concat_tables(tables or [schema().empty_table().select(columns)])

    def _content(self, name: str) -> bytes:
        """Return the lines of a file."""
        place = place_below(self._place, name)
        if not self._is_remote:
            return Path(place).read_bytes()
        try:
            return get(place)
        except StoreError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                raise error.__cause__ from error
            raise

    def _new_name(self, suffix: str) -> str:
        name = f"{self.run}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"
        return place_below(self._place, name)
