"""Logs in object stores: kinds with an index are read in part, others are copied."""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from quatprop.base.errors import QuatpropError, ReplacedError, StoreError
from quatprop.base.places import without_secret
from quatprop.readers.opening import open_folder, open_source, renamed_errors
from quatprop.stores.compression import file_compression
from quatprop.stores.file_source import FileSource
from quatprop.stores.kinds import READERS, kind_of, read_magic
from quatprop.stores.objects import below, find, is_transient, locate, reading
from quatprop.stores.remote import RemoteSource, bag_files, local_copy
from quatprop.stores.temp_files import temp_folder

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.readers.tables.model import Log
    from quatprop.stores.objects import StoredLog

_INDEXED_KINDS = {"mcap", "bag", "parquet", "feather"}
"""Kinds with an index, of which only the needed parts are read."""


@contextmanager
def unchanged(stored: StoredLog) -> Iterator[None]:
    """Raise ReplacedError if the log was replaced while this block read it."""
    try:
        yield
    except QuatpropError as error:
        if isinstance(error, ReplacedError) or is_transient(error):
            raise
        try:
            stored.confirm()
        except ReplacedError as replaced:
            raise replaced from error
        except StoreError:
            raise error from None
        raise
    stored.confirm()


def open_remote(stored: StoredLog, kind: str | None, stack: ExitStack) -> Log | Path:
    """Open a log in an object store, or return a temporary copy to open.

    `stack`: closes the log and removes the copy
    """
    address = stored.address
    with reading(address):
        file = Path(PurePosixPath(locate(address)[1]).name)
    name = without_secret(address)
    try:
        source = stack.enter_context(RemoteSource(address, file))
    except StoreError:
        if find(address)[1].is_file:
            raise
        return _open_remote_folder(stored, kind, stack)
    stored.objects.append(source.stored)
    with renamed_errors(file, name):
        head = read_magic(source)
        told = kind or ("" if file_compression(head) else kind_of(file, head))
    if told in _INDEXED_KINDS:
        stack.enter_context(renamed_errors(file, name))
        return open_source(source, told, stack)
    temp = temp_folder()
    stack.callback(temp.remove)
    copy = temp.path / file
    source.copy_to(copy)
    source.close()
    stack.enter_context(renamed_errors(copy, name))
    return copy


def _open_remote_folder(stored: StoredLog, kind: str | None, stack: ExitStack) -> Log:
    """Open a ROS 2 bag in an object store."""
    address = stored.address
    files = bag_files(address)
    indexed = {name for name in files if Path(name).suffix in READERS["mcap"].suffixes}
    copy = stack.enter_context(local_copy(address, stored.objects, set(files) - indexed))
    stack.enter_context(renamed_errors(copy, without_secret(address)))

    def source_of_part(part: Path) -> FileSource:
        if part.name not in indexed:
            return FileSource(part)
        source = RemoteSource(below(address, part.name), part)
        stored.objects.append(source.stored._replace(name=part.name))
        return source

    return open_folder(copy, kind, stack, source_of_part=source_of_part)
