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
from io import BufferedReader, FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.batch.entries import LISTS, TYPES, entries_in, json_line
from quatprop.errors import OutputError, StoreError
from quatprop.stores.objects import is_address, objects_of, without_secret
from quatprop.version import __version__
from quatprop.writers.atomic import OutputFile
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from quatprop.batch.entries import ManifestEntry
    from quatprop.pipeline.job import Job


class Manifest:
    """The manifest in the folder of a batch's outputs.

    `unused`: numbers of the lines that were no entries when they were last read
    """

    NAME = "manifest.jsonl"

    def __init__(self, folder: str) -> None:
        self._path = Path(folder, self.NAME)
        self._table = self._path.with_suffix(".parquet")
        self.files: tuple[str, ...] = (str(self._path), str(self._table))
        self.place, self.unused = str(self._path), list[int]()
        for name in self.files:
            refuse_outside(name, folder)
            if os.path.exists(name) and not os.path.isfile(name):  # noqa: PTH110, PTH113
                raise OutputError(name, "is no file; remove it")

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

    def record(self, entry: ManifestEntry) -> None:
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


def write_table(entries: Iterable[Mapping[str, Any]], path: Path) -> None:
    """Write entries as a table of Parquet, with a column for each field."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from pyarrow import json as arrow_json

    types = ((name, pa.type_for_alias(alias)) for name, alias in TYPES.items())
    schema = pa.schema([(name, pa.list_(of) if name in LISTS else of) for name, of in types])
    # Not from Python's values: pyarrow would import pandas, where that is installed, for 0.4 s.
    texts = (json.dumps(entry, ensure_ascii=False) for entry in entries)
    # Names of files need not be Unicode, which a table's text is.
    lines = "\n".join(texts).encode(errors="replace")
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
