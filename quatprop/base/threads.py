"""Overlap the stages of a run in threads; NumPy, Arrow and decompressors release the GIL.

Results are in the order of their input for any number of threads, so the output is the same to the
byte.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from itertools import chain, islice
from queue import SimpleQueue
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from concurrent.futures import Future

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST = 8
"""Maximum number of threads for the same work: more are not faster with files."""

AHEAD = 4
"""Maximum number of results computed ahead, so that memory is bounded."""

_STAGES = 3
"""Minimum number of threads for decompression in parallel, in addition to those of the stages."""

_wanted: ContextVar[int | None] = ContextVar("threads", default=None)


def available_cores() -> int:
    """Return the number of cores available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def thread_count() -> int:
    """Return the number of threads for computation: as set, or the number of cores."""
    return _wanted.get() or available_cores()


@contextmanager
def use_threads(count: int | None) -> Iterator[None]:
    """Set the number of threads in this block; None: unchanged."""
    token = _wanted.set(count or _wanted.get())
    try:
        yield
    finally:
        _wanted.reset(token)


def prefetch(
    function: Callable[[Item], Result], items: Iterable[Item]
) -> Generator[Result, None, None]:
    """Yield ``function(item)`` for each item, in order, computed a few items ahead.

    Close the iterator to stop early: running calls are waited for, others are cancelled.
    """
    workers = min(MOST, thread_count() - 1)
    rest = iter(items)
    first = [] if workers + 1 < _STAGES else list(islice(rest, workers + 2))
    if len(first) < workers + 2:
        yield from map(function, chain(first, rest))
        return
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(workers)
    waiting: deque[Future[Result]] = deque()
    try:
        for item in chain(first, rest):
            waiting.append(pool.submit(function, item))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def in_background(items: Iterable[Item], ahead: int | None = AHEAD) -> Generator[Item, None, None]:
    """Yield items computed ahead in another thread; with one thread, on demand.

    Close the iterator to stop early; `items` are closed in the thread that computed them.

    `ahead`: maximum number computed ahead; None: unlimited
    """
    if thread_count() == 1:
        yield from items
        return
    results: SimpleQueue[tuple[Item] | BaseException | None] = SimpleQueue()
    room = threading.Semaphore(sys.maxsize if ahead is None else ahead)
    stopped = threading.Event()

    def compute() -> None:
        stream = iter(items)
        last: BaseException | None = None
        try:
            for item in stream:
                results.put((item,))
                room.acquire()
                if stopped.is_set():
                    break
        except BaseException as error:  # noqa: BLE001  # raised where the items are used
            last = error
        finally:
            if hasattr(stream, "close"):
                stream.close()
            results.put(last)

    thread = threading.Thread(target=copy_context().run, args=(compute,), daemon=True)
    try:
        # An interruption must not separate the start of the thread from its cleanup. The thread
        # inherits the mask, so that signals reach the main thread.
        with signals_blocked(signal.valid_signals()):
            thread.start()
        while isinstance(result := results.get(), tuple):
            room.release()
            yield result[0]
            del result
        if result is not None:
            raise result
    finally:
        stopped.set()
        room.release()
        if thread.is_alive():
            thread.join()


@contextmanager
def signals_blocked(signals: Iterable[int], *, block: bool = True) -> Iterator[None]:
    """Block signals in this thread within a block, or unblock them."""
    if sys.platform == "win32" or not hasattr(signal, "pthread_sigmask"):
        yield
    else:
        how = signal.SIG_BLOCK if block else signal.SIG_UNBLOCK
        before = signal.pthread_sigmask(how, signals)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class OrderedThreadPool(Generic[Result]):
    """Threads whose results are written in the order of submission.

    `write`: called with each result, in the caller's thread
    """

    def __init__(self, work: Callable[..., Result], write: Callable[[Result], None]) -> None:
        from concurrent.futures import ThreadPoolExecutor

        self._work = work
        self._write = write
        count = min(MOST, thread_count())
        self._threads = ThreadPoolExecutor(count) if count > 1 else None
        self._ahead = 2 * count
        self._results: deque[Future[Result]] = deque()

    def submit(self, *piece: object) -> None:
        """Submit a piece of work; if too many are pending, wait for the oldest."""
        if self._threads is None:
            self._write(self._work(*piece))
            return
        self._results.append(self._threads.submit(self._work, *piece))
        if len(self._results) > self._ahead:
            self._write(self._results.popleft().result())

    def drain(self) -> None:
        """Wait for all pending work, and write the results."""
        while self._results:
            self._write(self._results.popleft().result())

    def shutdown(self) -> None:
        """End the threads and drop pending work; may be called twice."""
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)
        self._results.clear()
