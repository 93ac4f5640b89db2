"""Read objects of a store in ranges."""

from __future__ import annotations

import hashlib
import io
import os
import threading
from bisect import bisect_right
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, TypeVar

from quatprop.base.errors import OutputError
from quatprop.base.places import is_address, without_secret
from quatprop.stores.file_source import FileSource
from quatprop.stores.objects import (
    below,
    exists,
    find,
    list_objects,
    locate,
    reading,
    store_reason,
    stored_object,
)
from quatprop.stores.temp_files import temp_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence

    from pyarrow import NativeFile

    from quatprop.stores.compression import Buffer
    from quatprop.stores.objects import StoredObject

    Place = tuple[int, int]


SMALL_BYTES = 1 << 20
"""Maximum size of an object that is read at once."""

HEAD_BYTES, TAIL_BYTES = 1 << 12, 1 << 16
"""Bytes at the start and the end that are read first, where formats have their indexes."""

FIRST_REQUEST_BYTES, REQUEST_BYTES = 1 << 18, 1 << 23
"""Maximum size of the first request for several ranges, and of later ones, which double.

Often only the start of a log is needed.
"""

GAP_BYTES = 1 << 18
"""Maximum gap between two ranges, bytes, that is faster to read than a separate request.

The latency of a request is about 30 ms, or 2 ms with 16 concurrent requests, in which a network of
1 Gbit/s transfers about this many bytes.
"""

RANGES_BYTES = 1 << 21
"""Maximum size of a request for parts of a chunk; the bytes between them are dropped on arrival."""

ANNOUNCEMENTS = 8
"""Number of announcements that are kept, since topics are read in turn."""

SINGLE_BYTES = 1 << 16
"""Maximum size of a small read, bytes."""

AHEAD_BYTES = 1 << 24
"""Bytes read ahead of their use."""

BLOCK_BYTES = 1 << 23
"""Size of a request when an object is copied, bytes."""

KEPT_BYTES = 1 << 26
"""Bytes of read-ahead data that are kept."""

REQUESTS = 16
"""Number of concurrent requests."""

SINGLE_READS = 64
"""Number of unannounced small reads after which an object is copied: its index is unusable."""


class RemoteSource(FileSource):
    """An object of a store, read in ranges by several threads; errors are those of logs.

    `path`: its path for errors and readers
    `stored`: its identity in the store
    """

    is_remote = True

    def __init__(self, address: str, path: Path) -> None:
        self.path = path
        self._address = address
        self._pool = ThreadPoolExecutor(REQUESTS)
        self._lock = threading.Lock()
        self._copy_lock = threading.Lock()
        self._copy: FileSource | None = None
        self._parts: OrderedDict[Place, Future[bytes]] = OrderedDict()
        self._announced: list[list[Place]] = []
        with reading(address):
            store, place = locate(address)
            self._object = store.open_input_file(place)
            self.size = self._object.size()
            self.stored = stored_object(self._object, store, place)
        is_small = self.size <= SMALL_BYTES
        ends = [(0, HEAD_BYTES), (self.size - TAIL_BYTES, self.size)]
        self._announce([(0, self.size)] if is_small else ends)

    def expect(self, begins: Sequence[int], ends: Sequence[int]) -> None:
        """Announce ranges that will be read next, usually in this order."""
        if self.size > SMALL_BYTES and self._copy is None:
            self._announce(_requests(begins, ends))

    def read_ranges(self, begins: Sequence[int], ends: Sequence[int]) -> bytes:
        """Return the bytes of ranges, joined."""
        if self._copy is not None or self.size <= SMALL_BYTES:
            return super().read_ranges(begins, ends)
        self._single_reads = 0
        return b"".join(self._pool.map(self._fetch_together, _neighbours(begins, ends)))

    def as_arrow(self) -> NativeFile:
        """Return the object as an Arrow file."""
        import pyarrow as pa

        # With the object itself, errors of the store would look like damage of the log.
        return pa.PythonFile(_Stream(self), mode="r")

    def _announce(self, ranges: list[Place]) -> None:
        with self._lock:
            others = [each for each in self._announced if each != ranges]
            self._announced = [ranges, *others][:ANNOUNCEMENTS]
            self._single_reads = 0

    def _read(self, length: int, start: int) -> bytes:
        if self._copy is not None:
            return self._copy.read(start, length)
        with self._lock:
            if found := self._smallest_with(start, start + length):
                begin, part = found[0][found[1]][0], self._requested(*found)
            else:
                self._single_reads += length <= SINGLE_BYTES
                begin, part = start, None
        if part is None and self._single_reads > SINGLE_READS:
            return self._local().read(start, length)
        if part is None:
            part = self._pool.submit(self._fetch, start, start + length)
        return part.result()[start - begin : start - begin + length]

    def _smallest_with(self, start: int, end: int) -> tuple[list[Place], int] | None:
        """Return the announcement with the smallest range that contains some bytes, and its index.

        Ranges of another topic may contain them too, with many other bytes.
        """
        found = []
        for ranges in self._announced:
            number = bisect_right(ranges, (start, self.size)) - 1
            if number >= 0 and end <= ranges[number][1]:
                found.append((ranges, number))
        return min(found, key=lambda each: each[0][each[1]][1] - each[0][each[1]][0], default=None)

    def _requested(self, ranges: list[Place], number: int) -> Future[bytes]:
        """Return an announced range, and request those after it."""
        ahead = 0
        # The read-ahead grows with the number of ranges already read.
        for begin, end in ranges[number : 2 * number + 1]:
            if ahead > AHEAD_BYTES:
                break
            ahead += end - begin
            if (begin, end) not in self._parts:
                self._parts[begin, end] = self._pool.submit(self._fetch, begin, end)
        wanted = ranges[number]
        self._parts.move_to_end(wanted)
        kept = sum(end - begin for begin, end in self._parts)
        for begin, end in list(self._parts)[:-1]:
            if kept <= KEPT_BYTES or not self._parts[begin, end].done():
                break
            del self._parts[begin, end]
            kept -= end - begin
        return self._parts[wanted]

    def _fetch(self, begin: int, end: int) -> bytes:
        with reading(self._address):
            data = bytes(self._object.read_at(end - begin, begin))
        if end - begin == self.size:
            self.stored.read.append(_md5(data).hexdigest())
        return data

    def _fetch_together(self, places: list[Place]) -> bytes:
        """Return the bytes of ranges read by one request, without those between them."""
        first = places[0][0]
        data = self._fetch(first, places[-1][1])
        return b"".join([data[begin - first : end - first] for begin, end in places])

    def _local(self) -> FileSource:
        """Return a temporary copy of the whole object."""
        with self._copy_lock:
            if self._copy is None:
                self._temp = temp_folder()
                path = self._temp.path / self.path.name
                self.copy_to(path)
                self._copy = FileSource(path)
        return self._copy

    def copy_to(self, target: Path) -> None:
        """Copy the whole object to a file."""
        blocks = [(begin, begin + BLOCK_BYTES) for begin in range(0, self.size, BLOCK_BYTES)]
        if self.size > SMALL_BYTES:
            self._announce(blocks)
        digest = _md5()
        with target.open("wb") as file:
            for begin, end in blocks:
                file.write(data := self.read(begin, end - begin))
                digest.update(data)
        self.stored.read.append(digest.hexdigest())

    def close(self) -> None:
        """Close the object, and remove the copy."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        if self._copy is not None:
            self._copy.close()
            self._temp.remove()


@contextmanager
def local_copy(
    address: str, objects: list[StoredObject], names: Collection[str] | None = None
) -> Iterator[Path]:
    """Copy the files of a bag in a store to a temporary folder, removed when the block ends.

    `objects`: list to which the identities of the files are appended
    `names`: files to copy; others are created empty. None: all
    """
    temp = temp_folder()
    try:
        target = temp.path / PurePosixPath(locate(address)[1]).name
        target.mkdir()
        for name in bag_files(address):
            if names is None or name in names:
                with RemoteSource(below(address, name), target / name) as source:
                    source.copy_to(target / name)
                objects.append(source.stored._replace(name=name))
            else:
                (target / name).touch()
        yield target
    finally:
        temp.remove()


def bag_files(address: str) -> list[str]:
    """Return the names of the files of a bag in a store, without those in subfolders."""
    return [name for name in list_objects(address) if "/" not in name]


_md5 = partial(hashlib.md5, usedforsecurity=False)


class _Stream(io.RawIOBase):
    """A source as a stream."""

    def __init__(self, source: RemoteSource) -> None:
        self._source = source
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        origin = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._source.size}
        self._position = origin[whence] + offset
        return self._position

    def read(self, size: int = -1) -> bytes:
        data = self._source.read(self._position, self._source.size if size < 0 else size)
        self._position += len(data)
        return data


def _neighbours(begins: Sequence[int], ends: Sequence[int]) -> list[list[Place]]:
    """Return ranges in their order, grouped by request."""
    together: list[list[Place]] = []
    for begin, end in zip(begins, ends, strict=True):
        first, last = (together[-1][0][0], together[-1][-1][1]) if together else (0, -1)
        if 0 <= last <= begin <= last + GAP_BYTES and end - first <= RANGES_BYTES:
            together[-1].append((begin, end))
        else:
            together.append([(begin, end)])
    return together


def _requests(begins: Sequence[int], ends: Sequence[int]) -> list[Place]:
    """Return the ranges of the requests for sorted ranges, with close ones joined."""
    together: list[Place] = []
    for begin, end in sorted(zip(begins, ends, strict=True)):
        if together and begin <= together[-1][1] + GAP_BYTES:
            first, last = together[-1]
            most = min(REQUEST_BYTES, FIRST_REQUEST_BYTES << min(len(together), 9))
            if begin < last or end - first <= most:
                together[-1] = first, max(last, end)
                continue
        together.append((begin, end))
    return together


# Read, write, move and remove whole objects of stores.


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
