"""Whole objects, from object stores and to them."""

from __future__ import annotations

import shutil
import threading
from concurrent.futures import Future, wait
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, TypeVar

from quatprop.errors import OutputError
from quatprop.stores.objects import (
    below,
    find,
    list_objects,
    locate,
    reading,
    store_reason,
    without_secret,
)
from quatprop.stores.temp_files import temp_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from quatprop.stores.compression import Buffer

Result = TypeVar("Result")

BLOCK_BYTES = 1 << 24
"""Bytes that are copied at a time."""


@contextmanager
def local_copy(address: str, names: Collection[str] | None = None) -> Iterator[Path]:
    """Copy a log from an object store into a temporary folder, removed when the block ends.

    `names`: the files of a folder to copy; others are there, but empty. None is all
    """
    temp = temp_folder()
    try:
        _, found = find(address)
        target = temp.path / PurePosixPath(found.path).name
        if found.is_file:
            copy_object(address, target)
        else:
            target.mkdir()
            for name in bag_files(address):
                if names is None or name in names:
                    copy_object(below(address, name), target / name)
                else:
                    (target / name).touch()
        yield target
    finally:
        temp.remove()


def bag_files(address: str) -> list[str]:
    """Return the names of the files of a bag in a store, without those of folders inside."""
    return [name for name in list_objects(address) if "/" not in name]


def copy_object(address: str, target: Path) -> None:
    """Copy an object to a file."""

    def copy() -> None:
        store, place = locate(address)
        with store.open_input_stream(place) as source, target.open("wb") as file:
            shutil.copyfileobj(source, file, BLOCK_BYTES)

    with reading(address):
        interruptible(copy)


def get(address: str) -> bytes:
    """Return the content of an object."""
    with reading(address):
        store, place = locate(address)
        with store.open_input_file(place) as file:
            return bytes(file.read())


def upload(source: Path, address: str) -> None:
    """Copy a file or those of a folder to a store; an object is visible when it is complete."""
    import pyarrow as pa

    files = [source]
    if source.is_dir():
        files = sorted(file for file in source.rglob("*") if file.is_file())
        # What tells that there is a bag comes last.
        files.sort(key=lambda file: file.name == "metadata.yaml")
    for file in files:
        target = address
        if source.is_dir():
            target = below(address, file.relative_to(source).as_posix())
        put(target, pa.memory_map(str(file)).read_buffer() if file.stat().st_size else b"")


def put(address: str, data: Buffer) -> None:
    """Write an object."""

    def write() -> None:
        store, place = locate(address)
        with store.open_output_stream(place) as stream:
            stream.write(data)

    from pyarrow import ArrowException

    try:
        # A stream that an interruption ends would be closed, and half an object visible.
        interruptible(write)
    except (OSError, ValueError, ArrowException) as error:
        raise OutputError(without_secret(address), store_reason(error, address)) from error


def interruptible(work: Callable[[], Result]) -> Result:
    """Run `work` in a thread and wait for it, so that Ctrl-C is noticed, and ends the waiting."""
    done: Future[Result] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:  # noqa: BLE001  # raised in the thread that waits
            done.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    while not done.done():
        wait([done], timeout=0.1)
    return done.result()
