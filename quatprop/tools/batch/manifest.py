"""The manifest of a batch: the result of each log, in ``DIR/_manifest/``.

Entries are never changed, so that any number of batches may write to one folder or store prefix at
once, and may be killed at any time. A batch appends results to lines of JSON, which become a
Parquet part when they are many, and at its end. The latest entry for an output is the valid one.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import re
import secrets
import stat
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.base import __version__
from quatprop.base.errors import OutputError, StoreError
from quatprop.base.places import is_address, without_secret
from quatprop.base.provenance import as_json
from quatprop.stores.objects import list_objects, locate
from quatprop.stores.remote import get, put, remove
from quatprop.tools.batch.tasks import place_below
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import output_errors, refuse_outside

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import pyarrow as pa
    import pyarrow.dataset as ds


# The entries of a manifest, one per log, as lines of JSON or rows of a table.


COMPLETE = {"done", "data lost"}
"""States of logs whose output is complete."""

BUCKETS = 256
"""Number of buckets, by a hash of names, in which a large manifest is read."""


class ManifestEntry(NamedTuple):
    """The record of a log in a batch.

    Parameters
    ----------
    state
        ``"done"``; ``"data lost"``: done, but some data of the log were lost or omitted;
        ``"no rates"``: a table in a searched folder without body rates; ``"failed"``;
        ``"deleted"``: it was done, but the log no longer exists.
    root
        Absolute folder or address that holds the log.
    log
        Path of the log below `root`.
    output
        Path of the output in the folder of the batch, which identifies the entry.
    samples
        Number of samples propagated; 0 if a log that was done in an earlier batch cannot be used
        any more.
    rows
        Number of attitudes written.
    span_s
        Time from the first to the last sample, s.
    sample_rate_hz
        Mean rate of the samples, Hz.
    method
        Integration rule.
    final_wxyz
        Attitude at the last sample, body to reference, scalar first.
    remarks
        Remarks on the log and the result.
    losses
        Parts of the log that could not be read.
    error
        Why there is no output.
    seconds
        Wall time, s.
    log_bytes
        Size of the log; None if it could not be read.
    log_sha256
        SHA-256 of the log; None if it was not computed.
    log_etag
        ETag of a log in an object store; None for a local one.
    output_bytes
        Size of the output; None if there is none.
    output_sha256
        SHA-256 of the output; None if there is none.
    unmet
        How the log is not as expected, a sentence each; empty if it is, None if nothing was
        expected.
    attitudes_crc32
        Digest of the timestamps and attitudes alone, the same in every format and layout.
    quatprop
        Version that made the output.
    options
        Digest of all settings without paths, and of the files that they name.
    origin
        Size and modification time of the log at the start of reading.
    time
        Time of the record, as ISO 8601 in UTC.
    run
        Name of the batch.
    bucket
        Hash of the output's name.
    """

    state: str
    root: str
    log: str
    output: str
    samples: int | None = None
    rows: int | None = None
    span_s: float | None = None
    sample_rate_hz: float | None = None
    method: str | None = None
    final_wxyz: tuple[float, ...] | None = None
    remarks: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()
    error: str | None = None
    seconds: float = 0.0
    log_bytes: int | None = None
    log_sha256: str | None = None
    log_etag: str | None = None
    output_bytes: int | None = None
    output_sha256: str | None = None
    unmet: tuple[str, ...] | None = None
    attitudes_crc32: str | None = None
    quatprop: str = __version__
    options: str = ""
    origin: str = ""
    time: str = ""
    run: str = ""
    bucket: int = 0

    def recorded(self, run: str) -> ManifestEntry:
        """Return the entry with the current time, the batch and the bucket."""
        time = datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
        return self._replace(time=time, run=run, bucket=bucket_of(self.output))


TYPES: Mapping[str, str] = {
    **dict.fromkeys(ManifestEntry._fields, "string"),
    **dict.fromkeys(("samples", "rows", "log_bytes", "output_bytes"), "int64"),
    **dict.fromkeys(("span_s", "sample_rate_hz", "seconds", "final_wxyz"), "double"),
    "time": "time",
    "bucket": "uint8",
}
"""Field of an entry -> Arrow type of its values."""

LISTS = {"remarks", "losses", "unmet", "final_wxyz"}
"""Fields with several values."""

_REQUIRED = {"state", "root", "log", "output", "time", "run", "bucket", "origin"}


def hash_of(name: str) -> int:
    """Return a hash of a name, the same on any machine."""
    digest = hashlib.sha256(name.encode(errors="surrogateescape")).digest()
    return int.from_bytes(digest[:8], "little")


def bucket_of(output: str) -> int:
    """Return the bucket of an output."""
    return hash_of(as_text(output)) % BUCKETS


def as_text(name: str) -> str:
    """Return a name for a manifest, with an escape for each byte that is not UTF-8."""
    return _NO_UNICODE.sub(_escape, name)


_NO_UNICODE = re.compile("[\ud800-\udfff]")


def _escape(found: re.Match[str]) -> str:
    number = ord(found[0])
    return f"\\x{number - 0xDC00:02x}" if number >= _FIRST_BYTE else f"\\u{number:04x}"


_FIRST_BYTE = 0xDC80
"""Surrogates from here on are bytes of file names that are not UTF-8."""


def schema() -> pa.Schema:
    """Return the columns of a manifest."""
    import pyarrow as pa

    named = {"time": pa.timestamp("us", "UTC")}
    types = ((name, named.get(alias) or pa.type_for_alias(alias)) for name, alias in TYPES.items())
    return pa.schema([(name, pa.list_(of) if name in LISTS else of) for name, of in types])


def json_line(entry: ManifestEntry) -> bytes:
    """Return an entry as a line of JSON."""
    line = json.dumps(as_json(entry), ensure_ascii=False)
    # In JSON, a backslash is escaped.
    return (_NO_UNICODE.sub(lambda found: f"\\{_escape(found)}", line) + "\n").encode()


def table_of(lines: bytes) -> tuple[pa.Table, int]:
    """Return entries from lines of JSON, and the number of invalid lines.

    A last line without its end, from a killed process, is ignored.
    """
    import pyarrow as pa

    lines, unused = lines[: lines.rfind(b"\n") + 1], 0
    try:
        return _parsed(lines), 0
    except (pa.ArrowException, ValueError):
        tables = [schema().empty_table()]
        for line in filter(bytes.strip, lines.split(b"\n")):
            try:
                tables.append(_parsed(line))
            except (pa.ArrowException, ValueError):
                unused += 1
        return pa.concat_tables(tables), unused


def _parsed(lines: bytes) -> pa.Table:
    # From Python values, pyarrow would import pandas, if installed, which takes 0.4 s.
    from pyarrow import json as arrow_json

    if not lines:
        return schema().empty_table()
    table = arrow_json.read_json(
        io.BytesIO(lines),
        arrow_json.ReadOptions(block_size=len(lines) + 1, use_threads=False),
        arrow_json.ParseOptions(schema(), unexpected_field_behavior="ignore"),
    )
    if any(table[name].null_count for name in _REQUIRED):
        raise ValueError("a line is not an entry")
    return table


def distinct(table: pa.Table, keys: list[str]) -> pa.Table:
    """Return distinct entries, sorted by keys."""
    import pyarrow as pa
    import pyarrow.compute as pc

    table = table.sort_by([(key, "ascending") for key in keys])
    if not len(table):
        return table
    changes = [pc.not_equal(table[key][1:], table[key][:-1]) for key in keys]
    return pa.concat_tables([table[:1], table[1:].filter(reduce(pc.or_, changes))])


# The files of a manifest.


PART = ".pq"
"""Suffix of a Parquet part, which ``DIR/**/*.parquet`` does not match."""

LINES = ".jsonl"

LINE_BYTES = 256
"""Minimum size of an entry in a file of lines, bytes."""

SLICE_ROWS = 1 << 15
"""Approximate number of entries read at once."""

FOLDER = "_manifest"
"""Readers of datasets skip names that begin with an underscore."""

OBJECT_ENTRIES = 100
"""Maximum number of entries of an object of lines, which is rewritten for more of them."""

PART_ENTRIES = 1 << 14
"""Number of entries from which lines become a part."""

SMALL_BYTES = 1 << 16
"""Size below which parts are merged, bytes; a part has about 150 bytes an entry."""

MANY = 16
"""Number of small parts from which they are merged."""

REQUESTS = 16
"""Number of objects read at a time."""

_APPEND = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)

ABANDONED_S = 7 * 86_400
"""Age of files of lines, s, from which they are considered abandoned."""


class ManifestFile(NamedTuple):
    """Name, size and time, s, of a file of a manifest."""

    name: str
    size: int
    written: float


def _is_own(name: str) -> bool:
    """Return whether a file is a complete part or file of lines."""
    return name.endswith((PART, LINES)) and not name.startswith(".")


def new_run() -> str:
    """Return a name for a batch, with its start time."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}-{secrets.token_hex(4)}"


class Manifest:
    """The manifest in the folder, or below the address, of a batch's outputs.

    `run`: name of this batch
    `unused`: number of invalid lines in the last reading
    """

    def __init__(self, folder: str) -> None:
        self.folder, self.run, self.unused = folder, new_run(), 0
        self._place = place_below(folder, FOLDER)
        self.place = without_secret(self._place)
        self._is_remote = is_address(folder)
        self._lines: list[bytes] = []
        self._journals: list[str] = []
        self._journal, self._in_journal = "", 0
        if not self._is_remote:
            refuse_outside(self._place, folder)
            if Path(self._place).exists() and not Path(self._place).is_dir():
                raise OutputError(self._place, "is not a folder; remove it")

    def prepare(self) -> None:
        """Check that the manifest can be written."""
        if self._is_remote:
            put(self._begin(), b"")
            return
        with output_errors(self._place):
            Path(self._place).mkdir(parents=True, exist_ok=True)

    def record(self, *entries: ManifestEntry) -> list[ManifestEntry]:
        """Append entries, and return them with the time; after an error, a new file is begun."""
        if len(self._lines) >= PART_ENTRIES:
            self._close()
        recorded = [entry.recorded(self.run) for entry in entries]
        lines = [json_line(entry) for entry in recorded]
        is_full = self._is_remote and self._in_journal >= OBJECT_ENTRIES
        journal = self._begin() if is_full or not self._journal else self._journal
        self._journal = ""
        if self._is_remote:
            before = self._lines[len(self._lines) - self._in_journal :]
            put(journal, b"".join([*before, *lines]))
        else:
            with output_errors(self._place):
                file = os.open(journal, _APPEND, 0o666)
                try:
                    if os.write(file, text := b"".join(lines)) < len(text):
                        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                finally:
                    os.close(file)
        self._journal = journal
        self._in_journal += len(lines)
        self._lines += lines
        return recorded

    def _begin(self) -> str:
        """Begin a file of lines, and return its place."""
        self._journals.append(self._new_name(LINES))
        self._in_journal = 0
        self._journal = place_below(self._place, self._journals[-1])
        return self._journal

    def collect(self) -> None:
        """Make a part of this batch's lines, of those of killed batches, and of small parts."""
        self._close()
        limit, files = time.time() - ABANDONED_S, self._files()
        old = [f.name for f in files if f.name.endswith(LINES) and f.written < limit]
        small = [f.name for f in files if f.name.endswith(PART) and f.size < SMALL_BYTES]
        for names in [*([name] for name in old), *[small] * (len(small) >= MANY)]:
            with suppress(FileNotFoundError):  # another batch has just done so
                self._replace(names, self._tables(names, range(BUCKETS), [*TYPES]))

    def _close(self) -> None:
        """Replace the lines of this batch by a part."""
        if self._journals:
            self._replace(self._journals, table_of(b"".join(self._lines))[0])
        self._lines, self._journals, self._journal = [], [], ""

    def _replace(self, names: list[str], table: pa.Table) -> None:
        """Write a part, sorted by bucket, in place of files with the same entries.

        Concurrent readers may see an entry twice, which has no effect.
        """
        import pyarrow.parquet as pq

        if len(table):
            table = distinct(table, ["bucket", "output", "time", "run"])
            with open_atomic(place_below(self._place, self._new_name(PART))) as stream:
                pq.write_table(table, stream, compression="zstd", row_group_size=PART_ENTRIES)
        # Removed last: a kill before must not lose entries.
        for name in names:
            remove(place_below(self._place, name))

    def slices(self, columns: Sequence[str]) -> Iterator[tuple[range, dict[str, tuple[Any, ...]]]]:
        """Yield ranges of buckets, and their valid entries: output -> values of columns."""
        wanted = list(dict.fromkeys(["output", "time", *columns]))
        count = min(BUCKETS, self._rows() // SLICE_ROWS + 1)
        for number in range(count):
            buckets = range(number * BUCKETS // count, (number + 1) * BUCKETS // count)
            table = self._read(buckets, wanted).sort_by("time")
            values = zip(*(table[name].to_pylist() for name in columns), strict=True)
            yield buckets, dict(zip(table["output"].to_pylist(), values, strict=True))

    def history(self) -> pa.Table:
        """Return all entries ever recorded, sorted by output and time."""
        return distinct(self._read(range(BUCKETS), [*TYPES]), ["output", "time", "run"])

    def _rows(self) -> int:
        """Return the approximate number of entries."""
        while True:
            with suppress(FileNotFoundError):  # another batch has just merged one of them
                files = self._files()
                lines = sum(file.size for file in files if file.name.endswith(LINES))
                parts = [file.name for file in files if file.name.endswith(PART)]
                rows = self._dataset(parts).count_rows() if parts else 0
                return rows + lines // LINE_BYTES

    def _read(self, buckets: range, columns: list[str]) -> pa.Table:
        """Return entries of all files, unsorted."""
        while True:
            with suppress(FileNotFoundError):
                return self._tables([file.name for file in self._files()], buckets, columns)

    def _files(self) -> list[ManifestFile]:
        """Return all files, the oldest first.

        They are listed again if one was removed meanwhile, since its replacement may be missing.
        """
        while True:
            with suppress(FileNotFoundError):
                before, files = self._listed(), self._listed()
                if {file.name for file in before} <= {file.name for file in files}:
                    return sorted(file for file in files if file.size)

    def _listed(self) -> list[ManifestFile]:
        if self._is_remote:
            return [
                ManifestFile(name, info.size, (info.mtime_ns or 0) * 1e-9)
                for name, info in list_objects(self._place, missing_ok=True).items()
                if _is_own(name)
            ]
        found = []
        if os.path.isdir(self._place):
            with os.scandir(self._place) as entries:
                for entry in filter(lambda entry: _is_own(entry.name), entries):
                    status = entry.stat()
                    if stat.S_ISREG(status.st_mode):
                        found.append(ManifestFile(entry.name, status.st_size, status.st_mtime))
        return found

    def _dataset(self, parts: Sequence[str]) -> ds.Dataset:
        import pyarrow.dataset as ds

        store, place = locate(self._place) if self._is_remote else (None, self._place)
        paths = [f"{place}/{name}" for name in parts]
        return ds.dataset(paths, schema(), format="parquet", filesystem=store)

    def _tables(self, names: Sequence[str], buckets: range, columns: list[str]) -> pa.Table:
        """Return entries of some files; raises FileNotFoundError if one was merged meanwhile."""
        import pyarrow as pa
        import pyarrow.compute as pc

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
        return f"{self.run}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"
