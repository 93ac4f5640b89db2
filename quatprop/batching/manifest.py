"""The manifest of a batch: what became of each log, in ``DIR/_manifest/``, in parts.

Nothing in it is ever changed, so that any number of batches may write to one folder or prefix of a
store at once, and may be killed at any time. Each process appends the logs that it ends to a file
of its own, as lines of JSON. A batch that ends makes one part in Parquet of its own files. Parts of
a similar size are merged when there are many: the time that it takes to record a log does not grow
with the number of all logs. The latest entry about an output is the valid one.
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
"""Readers of data sets skip what begins with an underscore."""

OBJECT_ENTRIES = 100
"""Entries of an object with lines: nothing can be appended to it, and it is written again."""

FILE_ENTRIES = 1 << 14
"""Entries of a file with lines, which is parsed as a whole."""

REQUESTS = 16
"""Objects that are read at a time."""

SIMILAR = 4
"""Parts are similar whose sizes have the same number of bits, divided by this."""

MANY = 16
"""Similar parts from which they are merged."""

ABANDONED_S = 7 * 86_400
"""Age of lines that no batch will append to."""


def new_run() -> str:
    """Return a name for a batch, by its time."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}-{secrets.token_hex(4)}"


class _MergedError(Exception):
    """A file is no longer there: another batch has just merged it into a part."""


class Manifest:
    """The manifest in the folder, or below the address, of a batch's outputs.

    `run`: the name of this batch
    `unused`: number of lines that were no entries when they were last read
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
        """Find out whether it can be written, before anything is computed."""
        if self._is_remote:
            put(self._new_name(LINES), b"")
            return
        with output_errors(self._place):
            Path(self._place).mkdir(parents=True, exist_ok=True)

    def record(self, entry: ManifestEntry) -> ManifestEntry:
        """Append an entry, and return it; where that fails, the next one begins a new file."""
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
        """Let a process have a file of its own."""
        return {**self.__dict__, "_journal": "", "_lines": []}

    def slices(self, columns: Sequence[str]) -> Iterator[tuple[range, dict[str, tuple[Any, ...]]]]:
        """Yield the valid entries by output, as values of columns, in parts by their bucket."""
        for buckets in self._slices():
            wanted = list(dict.fromkeys(["output", "time", *columns]))
            table = self._read(buckets, wanted).sort_by("time")
            values = zip(*(table[name].to_pylist() for name in columns), strict=True)
            yield buckets, dict(zip(table["output"].to_pylist(), values, strict=True))

    def history(self) -> pa.Table:
        """Return all entries there ever were, by output and time."""
        return distinct(self._read(range(BUCKETS)), ["output", "time", "run"])

    def collect(self) -> None:
        """Make a part of the entries of this batch, and of those that killed ones have left."""
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
        """Make one part of some files, in order of the buckets, and remove them.

        Whoever reads meanwhile may see an entry twice, which is the same as once.
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
            # Not before the part is in its place: a kill would lose them.
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
        """Return name, size and time of all files, the oldest first.

        They are listed again where one was removed meanwhile: what took its place may be missing.
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
        """Return ranges of buckets of a bounded size, of some files if they are named."""
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
        """Return entries, from some files if they are named, in no order."""
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
        if len(buckets) < BUCKETS:  # else: what compares with a number imports pandas, for 0.4 s
            bucket = pc.field("bucket")
            chosen = (bucket >= buckets.start) & (bucket < buckets.stop)
        lines = [name for name in names if name.endswith(LINES)]
        tables, self.unused = [], 0
        with ThreadPoolExecutor(REQUESTS) as pool:
            # Files of this machine are large: one of them at a time.
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
