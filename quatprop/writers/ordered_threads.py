"""Threads whose results are written in the order in which the work was submitted.

For work that releases the interpreter lock: formatting numbers, compressing blocks. Meanwhile the
next samples are read and propagated.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

T = TypeVar("T")

THREADS = 2
AHEAD = 4
"""Pieces of work under way before the first result is awaited."""


class OrderedThreadPool(Generic[T]):
    """Threads, and a queue of their results.

    Parameters
    ----------
    work
        What the threads do.
    write
        Takes the results, one after the other, in the caller's thread.
    """

    def __init__(self, work: Callable[..., T], write: Callable[[T], None]) -> None:
        self._work = work
        self._write = write
        self._threads = ThreadPoolExecutor(THREADS)
        self._results: deque[Future[T]] = deque()

    def submit(self, *piece: object) -> None:
        """Submit a piece of work; where too many are under way, wait for the oldest."""
        self._results.append(self._threads.submit(self._work, *piece))
        if len(self._results) > AHEAD:
            self._write(self._results.popleft().result())

    def drain(self) -> None:
        """Wait for every piece of work and write its result."""
        while self._results:
            self._write(self._results.popleft().result())

    def shutdown(self) -> None:
        """End the threads and drop what is under way; may be called twice."""
        self._threads.shutdown(cancel_futures=True)
        self._results.clear()
