"""One Parquet dataset of all logs: a fixed number of files, to which logs are assigned by hash.

Each log is first written as a part. At the end of a batch, parts are merged into their file, sorted
by log, one row group at a time, and then removed; an empty part removes the rows of its log. The
content of a file only depends on its logs, not on the order in which they were added.
"""

from __future__ import annotations

import json
import os
import re
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

from quatprop.base.errors import OutputError, QuatpropError, StoreError, UsageError
from quatprop.base.guarded_text import ContentError, read_json
from quatprop.base.processes import KILLED, map_processes
from quatprop.base.provenance import METADATA_KEY, digest_of
from quatprop.base.text import Setting, plain, quoted
from quatprop.propagation.report import convention_of
from quatprop.stores.objects import is_address, list_objects, without_secret
from quatprop.stores.remote import RemoteSource, remove
from quatprop.stores.temp_files import locked, temp_folder
from quatprop.tools.batch.log_search import place_below
from quatprop.tools.batch.manifest import as_text, hash_of
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    import pyarrow as pa
    from pyarrow.parquet import ParquetFile

    from quatprop.tools.batch.log_search import BatchTask

PARTS = "_parts"
"""Readers of datasets skip names that begin with an underscore."""

SUFFIX = ".parquet"

_FILE = re.compile(r"(\d+)-of-(\d+)")
"""Name of a file and of the folder of its parts: its number, and the number of files."""

LOGS = b"quatprop logs"
"""Metadata key with the logs in a file."""


class LogRows(NamedTuple):
    """The rows of a log in a file.

    `sha256`: SHA-256 of the part that they were read from
    `groups`: number of row groups, which follow those of the previous log
    """

    log: str
    sha256: str | None
    groups: int


def number_of(log: BatchTask) -> int:
    """Return a hash of the name of a log, the same on any machine."""
    return hash_of(log.stem.lower())


def with_parts(tasks: Iterable[BatchTask], files: int) -> list[BatchTask]:
    """Return the logs of a batch as parts of a dataset; `files`: number of files."""
    width = len(str(files - 1))
    folders = [f"{PARTS}/{number:0{width}}-of-{files}/" for number in range(files)]
    return [task._replace(folder=folders[number_of(task) % files]) for task in tasks]


def file_of(name: str) -> str:
    """Return the name of the file for a part."""
    return name.split("/")[1] + SUFFIX


def refuse_mixture(outputs: Iterable[str], files: int | None, folder: str) -> None:
    """Refuse a folder with the outputs of another dataset, or with one file per log."""
    start, end = f"{PARTS}/", len(PARTS) + 1
    folders = {
        name[end : name.find("/", end)] if name.startswith(start) else "" for name in outputs
    }
    found = map(_FILE.fullmatch, folders)
    for other in {int(match[2]) if match else None for match in found} - {files}:
        what = f"one file per log; omit {Setting('dataset')}, or choose"
        if other:
            options = f"{Setting('dataset')} {Setting('buckets', str(other))}"
            what = f"a dataset of {other} files; choose {options}, or"
        raise UsageError(f"{quoted(without_secret(folder))} has {what} another folder")


def rows_in(folder: str, *, verify: bool) -> Callable[[str], LogRows | None]:
    """Return a function that returns the rows of a part in its file; each file is read once.

    `verify`: treat a file with damaged rows as empty
    """

    @cache
    def of_file(name: str) -> Mapping[str, LogRows]:
        with _opened(place_below(folder, name)) as (file, rows):
            return {} if verify and _is_damaged(file) else rows

    return lambda part: of_file(file_of(part)).get(part)


@contextmanager
def _opened(place: str) -> Iterator[tuple[ParquetFile | None, dict[str, LogRows]]]:
    """Open a file of a dataset, and yield it with its logs in order; None if it does not exist."""
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    file, rows = None, dict[str, LogRows]()
    with ExitStack() as stack:
        try:
            source: object = place
            if is_address(place):
                source = stack.enter_context(RemoteSource(place, Path("dataset"))).as_arrow()
            found = stack.enter_context(ParquetFile(source, page_checksum_verification=True))
            logs = read_json((found.metadata.metadata or {}).get(LOGS, b""))
            file, rows = found, {name: LogRows(*values) for name, values in logs.items()}
        except StoreError as error:
            if not isinstance(error.__cause__, FileNotFoundError):
                raise
        except (ArrowException, OSError, ValueError) as error:
            number = getattr(error, "errno", None)
            if number and not isinstance(error, FileNotFoundError):
                # Not Arrow's own words, which repeat the path.
                raise OutputError(place, f"cannot be read: {os.strerror(number)}") from error
        yield file, rows


def _is_damaged(file: ParquetFile | None) -> bool:
    """Return whether any row group cannot be read, or has a wrong checksum."""
    from pyarrow import ArrowException

    try:
        for group in range(0 if file is None else file.num_row_groups):
            file.read_row_group(group)  # type: ignore[union-attr]
    except (ArrowException, OSError):
        return True
    return False


def merge_parts(folder: str, wanted: Callable[[int], bool], processes: int) -> None:
    """Merge the parts of a dataset into its files.

    `wanted`: returns whether the file with a number belongs to this batch
    """
    place = place_below(folder, PARTS)
    if is_address(folder):
        names = {name.split("/")[0] for name in list_objects(place, missing_ok=True)}
    else:
        names = {path.name for path in Path(place).glob("*")}
    found = filter(None, map(_FILE.fullmatch, names))
    files = sorted(match[0] for match in found if wanted(int(match[1])))

    def on_killed(name: str) -> str:
        return f"{plain(without_secret(place_below(folder, name + SUFFIX)))}: {KILLED}"

    results = map_processes(partial(_merged, folder), files, processes, on_killed)
    if errors := [error for _, error in results if error]:
        raise QuatpropError(errors[0])


def _merged(folder: str, name: str) -> str:
    """Merge the parts of one file; return an error, or ``""``."""
    target, top = place_below(folder, name + SUFFIX), place_below(folder, f"{PARTS}/{name}")
    try:
        if not is_address(folder):
            refuse_outside(target, folder)
        # Two batches may write to one folder; stores have no locks.
        with locked(Path(top)), _parts_in(top) as parts:
            if parts:
                _merge(target, {f"{PARTS}/{name}/{part}": path for part, path in parts.items()})
                _remove_parts(top, parts)
    except QuatpropError as error:
        return error.text
    return ""


@contextmanager
def _parts_in(top: str) -> Iterator[dict[str, Path]]:
    """Yield the parts of a file by name, those in a store as copies."""
    if not is_address(top):
        found = Path(top).rglob(f"*{SUFFIX}")
        yield {path.relative_to(top).as_posix(): path for path in found if path.is_file()}
        return
    temp, parts = temp_folder(), dict[str, Path]()
    try:
        for number, name in enumerate(list_objects(top, missing_ok=True)):
            parts[name] = temp.path / f"{number}"
            with RemoteSource(place_below(top, name), parts[name]) as source:
                source.copy_to(parts[name])
        yield parts
    finally:
        temp.remove()


def _remove_parts(top: str, names: Iterable[str]) -> None:
    """Remove parts, and folders below `top` that are then empty."""
    for name in names:
        remove(place_below(top, name))
        with suppress(OSError):
            for above in Path(name).parents[:-1] if not is_address(top) else ():
                Path(top, above).rmdir()


class _Source(NamedTuple):
    """The source of the rows of a log: a part, or without a path, the previous file."""

    rows: LogRows
    path: Path | None
    first: int = 0


def _merge(target: str, parts: Mapping[str, Path]) -> None:
    """Rewrite a file with the rows of parts in place of the previous rows of their logs."""
    with _opened(target) as (before, known):
        sources, first = dict[str, _Source](), 0
        for name, rows in known.items():
            sources[name] = _Source(rows, None, first)
            first += rows.groups
        for name, path in parts.items():
            sources.pop(name, None)
            if path.stat().st_size:
                sources[name] = _Source(_rows_of(path), path)
        order = sorted(sources, key=lambda name: (sources[name].rows.log, name))
        if order:
            _write(target, {name: sources[name] for name in order}, before)
    if not order:
        remove(target)


def _rows_of(part: Path) -> LogRows:
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    try:
        with ParquetFile(part) as file:
            log = read_json(file.metadata.metadata[METADATA_KEY])["source"]["path"]
            return LogRows(log, digest_of(part).sha256, file.num_row_groups)
    except (ArrowException, OSError) as error:
        raise _unreadable(part, error) from error
    except (ContentError, KeyError, TypeError) as error:
        raise OutputError(part, "no batch has written this; remove it") from error


def _unreadable(place: str | Path, error: Exception) -> OutputError:
    return OutputError(
        without_secret(place),
        f"its rows cannot be read ({plain(error)}); remove it, and continue with "
        f"{Setting('skip_existing')}",
    )


def _write(target: str, sources: Mapping[str, _Source], before: ParquetFile | None) -> None:
    """Write the rows of all logs, with the logs and their provenance in the metadata."""
    from pyarrow.parquet import ParquetFile

    from quatprop.writers.parquet import parquet_writer

    logs = {name: source.rows for name, source in sources.items()}
    writer, metadata = None, {LOGS: json.dumps(logs).encode()}
    with open_atomic(target) as stream, ExitStack() as stack:
        for rows, path, first in sources.values():
            log = as_text(rows.log)
            own_key = METADATA_KEY + f" {log}".encode()
            with ParquetFile(path) if path else nullcontext(cast("ParquetFile", before)) as file:
                metadata[own_key] = file.metadata.metadata[METADATA_KEY if path else own_key]
                for group in range(first, first + rows.groups):
                    table = _group(file, group, log, target)
                    if writer is None:
                        writer = parquet_writer(stream, table.schema, write_page_checksum=True)
                        stack.enter_context(writer)
                    if writer.schema != table.schema:
                        raise OutputError(
                            without_secret(target),
                            f"{quoted(log)} has other columns than other logs in it; propagate all "
                            "logs with the same options, or write to another folder",
                        )
                    writer.write_table(table)
        if writer is not None:
            layout = read_json(metadata[own_key])["convention"]["layout"]
            metadata[METADATA_KEY] = json.dumps(convention_of(layout)).encode()
            writer.add_key_value_metadata(metadata)


def _group(file: ParquetFile, number: int, log: str, target: str) -> pa.Table:
    """Return a row group with a column for its log, as one chunk, so that pages are the same."""
    import pyarrow as pa

    try:
        table = file.read_row_group(number).combine_chunks()
    except (pa.ArrowException, OSError) as error:
        raise _unreadable(target, error) from error
    if "log" in table.column_names:
        table = table.drop_columns("log")
    field = pa.field("log", pa.string(), nullable=False)
    return table.add_column(0, field, pa.repeat(log, len(table))).replace_schema_metadata(None)
