"""The entries of a manifest, one per log, as lines of JSON or rows of a table."""

from __future__ import annotations

import hashlib
import io
import json
import re
from datetime import UTC, datetime
from functools import reduce
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.provenance import as_json
from quatprop.settings.guarded_text import ContentError, read_json
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import pyarrow as pa

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
    root, log
        Absolute folder or address, and path of the log below it.
    output
        Path of the output in the folder of the batch, which identifies the entry.
    samples, rows
        Number of samples propagated and of attitudes written.
    span_s, sample_rate_hz, method, final_wxyz
        Time span, s, rate, Hz, integration rule and last attitude, body to reference.
    remarks, losses
        Remarks on the log and the result; parts that could not be read.
    error
        Why there is no output.
    seconds
        Wall time, s.
    log_bytes, log_sha256, log_etag, output_bytes, output_sha256
        Sizes and digests; None if there are none. A log in an object store has its ETag.
    quatprop, options
        The version, and a digest of all settings without paths, and of the files that they name.
    origin
        Size and modification time of the log at the start of reading.
    time, run
        Time of the record, as ISO 8601 in UTC, and name of the batch.
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

LISTS = {"remarks", "losses", "final_wxyz"}
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

    lines = lines[: lines.rfind(b"\n") + 1]
    try:
        return _parsed(lines), 0
    except (pa.ArrowException, ValueError):
        whole = [line for line in lines.split(b"\n") if line.strip()]
        entries = [line for line in whole if _is_entry(line)]
        return _parsed(b"".join(line + b"\n" for line in entries)), len(whole) - len(entries)


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


_MAX_COUNT = (1 << 63) - 1

_IS_VALID: Mapping[str, Callable[[Any], bool]] = {
    "string": lambda value: isinstance(value, str),
    "time": lambda value: isinstance(value, str) and _is_time(value),
    "int64": lambda value: type(value) is int and 0 <= value <= _MAX_COUNT,
    "uint8": lambda value: type(value) is int and 0 <= value < BUCKETS,
    "double": lambda value: type(value) in {int, float},
}


def _is_time(value: str) -> bool:
    try:
        return datetime.fromisoformat(value).tzinfo is not None
    except ValueError:
        return False


def _is_valid(name: str, value: object) -> bool:
    values = value if name in LISTS else [value]
    return isinstance(values, list) and all(map(_IS_VALID[TYPES[name]], values))


def _is_entry(line: bytes) -> bool:
    """Return whether a line is a valid entry; other versions may have other fields."""
    try:
        entry = read_json(line)
    except ContentError:
        return False
    return isinstance(entry, dict) and all(
        name not in _REQUIRED if entry.get(name) is None else _is_valid(name, entry[name])
        for name in TYPES
    )


def distinct(table: pa.Table, keys: list[str]) -> pa.Table:
    """Return distinct entries, sorted by keys."""
    import pyarrow as pa
    import pyarrow.compute as pc

    table = table.sort_by([(key, "ascending") for key in keys])
    if not len(table):
        return table
    changes = [pc.not_equal(table[key][1:], table[key][:-1]) for key in keys]
    return pa.concat_tables([table[:1], table[1:].filter(reduce(pc.or_, changes))])
