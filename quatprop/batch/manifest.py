"""The manifest of a batch: one line of JSON for each log, appended as soon as the log has ended.

Several batches may write to one folder at once, and each may be killed at any time: a line is
written at once and under a lock, and a line that was cut is ignored. The last line about an output
is the valid one.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from contextlib import contextmanager, suppress
from functools import partial
from io import BufferedReader, FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

from quatprop import __version__
from quatprop.containers.stores import is_address, objects_of, without_secret
from quatprop.errors import StoreError
from quatprop.guarded_text import ContentError, read_json
from quatprop.provenance import as_json
from quatprop.writers.atomic import OutputFile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from quatprop.pipeline.job import Job

COMPLETE = {"done", "data lost"}
"""States of logs whose output is complete."""


class ManifestEntry(NamedTuple):
    """What a batch records of a log.

    Parameters
    ----------
    state
        ``"done"``; ``"data lost"``: done, but some data of the log were lost or left out;
        ``"no rates"``: a table found in a folder, without body rates; ``"failed"``.
    log
        Absolute path or address.
    output
        Path of the output in the folder of the manifest.
    samples, rows, span_s, sample_rate_hz, method, final_wxyz
        As in the report; None where there is no output.
    remarks, losses
        As in the report.
    error
        Why there is no output.
    seconds
        Duration, s.
    log_bytes, log_sha256, log_etag, output_bytes, output_sha256
        Sizes and digests; None where there are none. A log in an object store has the ETag that
        the store gives it.
    quatprop
        The version.
    options
        Digest of all settings but the paths.
    origin
        Digest of the version, the settings, and names, sizes and times of all files that are read,
        and of their ETags in an object store; None where they cannot be found out.
    """

    state: str
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
    origin: str | None = None


class Manifest:
    """The manifest in the folder of a batch's outputs.

    Parameters
    ----------
    folder
        The folder.

    Attributes
    ----------
    files
        The manifest and its table.
    place
        The manifest as it may be shown.
    unused
        Numbers of the lines that were no entries when they were last read.
    """

    NAME = "manifest.jsonl"

    def __init__(self, folder: str) -> None:
        self._path = Path(folder, self.NAME)
        self._table = self._path.with_suffix(".parquet")
        self.files: tuple[str, ...] = (str(self._path), str(self._table))
        self.place, self.unused = str(self._path), list[int]()

    def prepare(self) -> None:
        """Make the folder."""
        self._path.parent.mkdir(parents=True, exist_ok=True)

    def existing_outputs(self) -> Callable[[str], bool]:
        """Return a function that tells whether an output is there, by its path in the folder."""
        folder = str(self._path.parent)
        return lambda name: os.path.exists(os.path.join(folder, name))  # noqa: PTH110, PTH118

    def entries(self) -> dict[str, Mapping[str, Any]]:
        """Return the valid entry of each output, by its path in the folder."""
        self.unused = []
        return {entry["output"]: entry for entry in self._read()}

    def _read(self) -> Iterator[Mapping[str, Any]]:
        with suppress(FileNotFoundError), self._path.open("rb") as stream:
            yield from entries_in(stream, self.unused)

    def append(self, entry: ManifestEntry) -> None:
        """Append an entry."""
        with self._locked() as stream:
            cut = False
            if stream.seek(0, os.SEEK_END):
                stream.seek(-1, os.SEEK_END)
                cut = stream.read(1) != b"\n"  # by a kill
            stream.write((b"\n" if cut else b"") + json_line(entry))

    def write_table(self) -> None:
        """Write the valid entries as ``manifest.parquet``, in the order of the outputs.

        Other batches wait meanwhile: a table of fewer entries must not come after theirs.
        """
        with self._locked() as stream:
            lines = BufferedReader(stream)
            entries = {entry["output"]: entry for entry in entries_in(lines, [])}
            write_table((entry for _, entry in sorted(entries.items())), self._table)

    @contextmanager
    def _locked(self) -> Iterator[FileIO]:
        """Open the manifest, at its beginning, while no other batch writes to it."""
        with FileIO(self._path, "a+") as stream:
            with suppress(ImportError, OSError):  # Windows, or a file system without locks
                import fcntl

                fcntl.lockf(stream, fcntl.LOCK_EX)
            stream.seek(0)
            yield stream


def entries_in(lines: Iterable[bytes], unused: list[int]) -> Iterator[Mapping[str, Any]]:
    """Yield the entries of the lines of a manifest.

    Parameters
    ----------
    lines
        The lines.
    unused
        Where the numbers of lines go that are no entries, but for those that a kill has cut.
    """
    for number, line in enumerate(lines, 1):
        try:
            entry = read_json(line)
        except ContentError:
            entry = None
        if _is_entry(entry):
            yield entry
        elif line.strip() and not (line.startswith(_BEGINNING) and line.rstrip()[-1:] != b"}"):
            unused.append(number)


_BEGINNING = b'{"state": '

_MAX_COUNT = (1 << 63) - 1


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value <= _MAX_COUNT


def _is_number(value: object) -> bool:
    return type(value) in {int, float}


def _is_list(value: object, is_valid: Callable[[object], bool]) -> bool:
    return isinstance(value, list) and all(map(is_valid, value))


_IS_VALID: Mapping[str, Callable[[object], bool]] = {
    **dict.fromkeys(ManifestEntry._fields, _is_text),
    **dict.fromkeys(("samples", "rows", "log_bytes", "output_bytes"), _is_count),
    **dict.fromkeys(("span_s", "sample_rate_hz", "seconds"), _is_number),
    **dict.fromkeys(("remarks", "losses"), partial(_is_list, is_valid=_is_text)),
    "final_wxyz": partial(_is_list, is_valid=_is_number),
}
"""Field of an entry -> whether a value in the manifest is valid."""


def _is_entry(entry: object) -> TypeGuard[Mapping[str, Any]]:
    """Return whether a line is what a batch writes; other versions may have other fields."""
    return (
        isinstance(entry, dict)
        and all(isinstance(entry.get(name), str) for name in ("state", "log", "output"))
        and all(
            entry.get(name) is None or is_valid(entry[name]) for name, is_valid in _IS_VALID.items()
        )
    )


def json_line(entry: ManifestEntry | Mapping[str, Any]) -> bytes:
    """Return an entry as a line of JSON."""
    text = json.dumps(as_json(entry), ensure_ascii=False) + "\n"
    return text.encode(errors="surrogateescape")


def write_table(entries: Iterable[Mapping[str, Any]], path: Path) -> None:
    """Write entries as a table of Parquet, with a column for each field."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from pyarrow import json as arrow_json

    text, count, number = pa.string(), pa.int64(), pa.float64()
    types = {
        "samples": count, "rows": count, "span_s": number, "sample_rate_hz": number,
        "final_wxyz": pa.list_(number), "remarks": pa.list_(text), "losses": pa.list_(text),
        "seconds": number, "log_bytes": count, "output_bytes": count,
    }  # fmt: skip
    names = ManifestEntry._fields
    schema = pa.schema([(name, types.get(name, text)) for name in names])
    # Not from Python's values: pyarrow would import pandas, where that is installed, for 0.4 s.
    lines = "\n".join(map(json.dumps, entries)).encode()
    output = OutputFile(path)
    try:
        with pq.ParquetWriter(output.stream, schema) as writer:
            if lines:
                writer.write_table(
                    arrow_json.read_json(
                        io.BytesIO(lines),
                        arrow_json.ReadOptions(block_size=len(lines) + 1),
                        arrow_json.ParseOptions(schema, unexpected_field_behavior="ignore"),
                    )
                )
        output.commit()
    finally:
        output.discard()


def options_digest(job: Job) -> str:
    """Return a digest of all settings of a job but its paths."""
    return hashlib.sha256(repr((job.settings, job.output._replace(path=""))).encode()).hexdigest()


def origin_digest(inputs: Iterable[str], options: str) -> str | None:
    """Return a digest of what an output is made from: version, settings, and the files it reads.

    None where a store does not say what it has.
    """
    files: list[tuple[object, ...]] = []
    for name in inputs:
        if is_address(name):
            try:
                files += objects_of(name)
            except StoreError:
                return None
            continue
        place = Path(name)
        # Definitions of messages may be in packages below.
        inside = {*place.iterdir(), *place.rglob("*.msg")} if place.is_dir() else {place}
        for file in sorted(inside):
            with suppress(OSError):
                status = file.stat()
                files.append((file.name, status.st_size, status.st_mtime_ns))
    return hashlib.sha256(repr((__version__, options, files)).encode()).hexdigest()


def log_name(log: str) -> str:
    """Return how the manifest names a log: by an absolute path, or an address without secrets."""
    return without_secret(log) if is_address(log) else os.path.abspath(log)  # noqa: PTH100
