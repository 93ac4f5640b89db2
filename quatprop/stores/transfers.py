"""Read, write, move and remove whole objects of stores."""

from __future__ import annotations

import os
import threading
from concurrent.futures import Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from quatprop.errors import OutputError
from quatprop.stores.objects import (
    below,
    exists,
    find,
    is_address,
    list_objects,
    locate,
    reading,
    store_reason,
    without_secret,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.stores.compression import Buffer

Result = TypeVar("Result")


def get(address: str) -> bytes:
    """Return the content of an object."""
    with reading(address):
        store, place = locate(address)
        with store.open_input_file(place) as file:
            return bytes(file.read())


def upload(source: Path, address: str) -> None:
    """Copy a file, or the files of a folder, to a store; objects become visible when complete."""
    import pyarrow as pa

    files = [source]
    if source.is_dir():
        files = sorted(file for file in source.rglob("*") if file.is_file())
        # The metadata, which identify a bag, come last.
        files.sort(key=lambda file: file.name == "metadata.yaml")
    for file in files:
        target = address
        if source.is_dir():
            target = below(address, file.relative_to(source).as_posix())
        put(target, pa.memory_map(str(file)).read_buffer() if file.stat().st_size else b"")


def remove(place: str) -> None:
    """Remove a file or an object, if it exists."""
    if is_address(place):
        with reading(place):
            store, path = locate(place)
            store.delete_file(path)
        return
    try:
        Path(place).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(place, f"cannot be removed: {error.strerror}") from error


def move(source: str, target: str) -> None:
    """Move a file, a folder or objects, replacing the target; no effect if there are no objects."""
    import shutil

    if is_address(source):
        is_file = exists(source) and find(source)[1].is_file
        for name in [""] if is_file else list_objects(source, missing_ok=True):
            one, other = (below(place, name) if name else place for place in (source, target))
            put(other, get(one))
            remove(one)
        return
    try:
        if os.path.isdir(target):  # noqa: PTH112
            shutil.rmtree(target)
        os.makedirs(os.path.dirname(target), exist_ok=True)  # noqa: PTH103, PTH120
        os.replace(source, target)  # noqa: PTH105
    except OSError as error:
        raise OutputError(target, f"cannot be written: {error.strerror}") from error


def put(address: str, data: Buffer) -> None:
    """Write an object."""

    def write() -> None:
        store, place = locate(address)
        with store.open_output_stream(place) as stream:
            stream.write(data)

    from pyarrow import ArrowException

    try:
        # An interruption would close the stream, and make half an object visible.
        interruptible(write)
    except (OSError, ValueError, ArrowException) as error:
        raise OutputError(without_secret(address), store_reason(error, address)) from error


def interruptible(work: Callable[[], Result]) -> Result:
    """Run `work` in a thread and wait for it, so that Ctrl-C can interrupt the wait."""
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
