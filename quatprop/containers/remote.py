"""Logs in object stores, copied to this machine for the time they are read."""

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

RETRY_S = 10
"""Seconds for which a store that does not answer is retried."""

MAX_REASON = 240
"""Characters of a store library's message that are shown; the rest repeats itself."""


def is_address(path: Path | str) -> bool:
    """Tell whether a path is an address such as ``s3://bucket/log.mcap``."""
    return "://" in str(path)


def without_secret(path: Path | str) -> str:
    """Return a path or an address as it may be recorded: without credentials in it.

    Examples
    --------
    >>> without_secret("s3://key:secret@bucket/log.mcap")
    's3://bucket/log.mcap'
    """
    return re.sub(r"(?<=://)[^/?#]*@", "", str(path)) if is_address(path) else str(path)


@contextmanager
def local_copy(address: str) -> Iterator[Path]:
    """Copy a log from an object store into a temporary folder, removed when the block ends.

    Parameters
    ----------
    address
        Of a file, or of a folder with a ROS 2 bag, in a file system that Arrow knows: ``s3://``,
        ``gs://``, ``abfs://``, ``hdfs://``, ``file://``. Credentials are looked up as
        the store's own tools do.

    Yields
    ------
    Path
        The copy, under the same name.

    Raises
    ------
    UnreadableLogError
        There is no such object, or it may not be read.
    """
    name = without_secret(address)
    with tempfile.TemporaryDirectory(prefix="quatprop-") as folder:
        try:
            target = _interruptible(lambda: _copied(address, Path(folder)))
        except (OSError, ValueError) as error:
            reason = shorten(str(error).replace(address, name), MAX_REASON, placeholder="...")
            raise UnreadableLogError(
                name,
                f"it cannot be read from its store ({reason}); check the address and access",
            ) from error
        yield target


def _copied(address: str, folder: Path) -> Path:
    """Copy the object at an address into a folder, and return the copy."""
    from pyarrow.fs import FileSystem, FileType

    store, place = FileSystem.from_uri(_with_retry_limit(address))
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


def _with_retry_limit(address: str) -> str:
    """Return an address with a limit of retries: gs:// goes on for a quarter of an hour."""
    if not address.startswith(("gs://", "gcs://")) or "retry_limit_seconds" in address:
        return address
    return f"{address}{'&' if '?' in address else '?'}retry_limit_seconds={RETRY_S}"


def _interruptible(work: Callable[[], Path]) -> Path:
    """Run `work` in a thread and wait for it, so that Ctrl-C is noticed."""
    done: Future[Path] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:  # noqa: BLE001  # raised in the thread that waits
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
