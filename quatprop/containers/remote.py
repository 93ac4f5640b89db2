"""Logs in object stores, copied to this machine while they are read."""

from __future__ import annotations

import re
import shutil
import tempfile
import threading
from concurrent.futures import Future, wait
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from textwrap import shorten
from typing import TYPE_CHECKING

from quatprop.errors import UnreadableLogError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pyarrow.fs import FileSystem

BLOCK_BYTES = 1 << 24
"""Bytes that are copied at a time."""

PATIENCE_S = 10
"""Seconds for which a store that does not answer is asked again."""

REASON = 240
"""Letters of what a store's library says that are shown; the rest repeats itself."""


def is_address(path: Path | str) -> bool:
    """Tell an address such as ``s3://bucket/log.mcap`` from a path."""
    return "://" in str(path)


def without_secret(path: Path | str) -> str:
    """Return a path or an address as it may be recorded: without a key that it carries.

    Examples
    --------
    >>> without_secret("s3://key:secret@bucket/log.mcap")
    's3://bucket/log.mcap'
    """
    return re.sub(r"(?<=://)[^/?#]*@", "", str(path)) if is_address(path) else str(path)


@contextmanager
def local_copy(address: str) -> Iterator[Path]:
    """Copy a log from an object store into a temporary folder; it goes when the block ends.

    Parameters
    ----------
    address
        Of a file, or of a folder with a ROS 2 bag, in a file system that Arrow knows: ``s3://``,
        ``gs://``, ``abfs://``, ``hdfs://``, ``file://``. Credentials are taken from where the
        store's own tools take them.

    Yields
    ------
    Path
        The copy, under the same name.

    Raises
    ------
    UnreadableLogError
        The store does not know the address, or does not let it be read.
    """
    name = without_secret(address)
    with tempfile.TemporaryDirectory(prefix="quatprop-") as folder:
        try:
            target = _interruptible(lambda: _copied(address, Path(folder)))
        except (OSError, ValueError) as error:
            reason = shorten(str(error).replace(address, name), REASON, placeholder="...")
            raise UnreadableLogError(
                name,
                f"it cannot be read from its store ({reason}); check the address and access",
            ) from error
        yield target


def _copied(address: str, folder: Path) -> Path:
    """Copy what is at an address into a folder, and return the copy."""
    from pyarrow.fs import FileSystem, FileType

    store, place = FileSystem.from_uri(_impatient(address))
    found = store.get_file_info(place)
    target = folder / PurePosixPath(place).name
    if found.type == FileType.NotFound:
        name = without_secret(address)
        raise UnreadableLogError(name, "there is no such object; check the address")
    if found.type == FileType.Directory:
        _copy_folder(store, place, target)
    else:
        _copy_file(store, place, target)
    return target


def _impatient(address: str) -> str:
    """Return an address whose store is not asked again for a quarter of an hour, as gs:// is."""
    if not address.startswith(("gs://", "gcs://")) or "retry_limit_seconds" in address:
        return address
    return f"{address}{'&' if '?' in address else '?'}retry_limit_seconds={PATIENCE_S}"


def _interruptible(work: Callable[[], Path]) -> Path:
    """Do something that hears no Ctrl-C in a thread, so that the waiting for it does."""
    done: Future[Path] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:  # noqa: BLE001  # it is raised where it is waited for
            done.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    while not done.done():
        wait([done], timeout=0.1)
    return done.result()


def _copy_folder(store: FileSystem, place: str, target: Path) -> None:
    """Copy the files of a folder; a bag has no folders inside."""
    from pyarrow.fs import FileSelector

    target.mkdir()
    for found in store.get_file_info(FileSelector(place)):
        if found.is_file:
            _copy_file(store, found.path, target / PurePosixPath(found.path).name)


def _copy_file(store: FileSystem, place: str, target: Path) -> None:
    with store.open_input_stream(place) as source, target.open("wb") as copy:
        shutil.copyfileobj(source, copy, BLOCK_BYTES)
