"""Work in threads whose results are taken in the order in which it was given out.

For work that does not hold the interpreter: formatting numbers, compressing blocks. While it goes
on, the next samples are read and propagated.
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
"""Pieces of work under way before the first result must be taken."""


class OrderedThreadPool(Generic[T]):
    """Threads, and a queue of their results.

    Parameters
    ----------
    work
        What the threads do.
    take
        Takes the results, one after the other, in the caller's thread.
    """

    def __init__(self, work: Callable[..., T], take: Callable[[T], None]) -> None:
        self._work = work
        self._take = take
        self._threads = ThreadPoolExecutor(THREADS)
        self._results: deque[Future[T]] = deque()

    def give(self, *piece: object) -> None:
        """Give out a piece of work, after taking the oldest result where too many are due."""
        self._results.append(self._threads.submit(self._work, *piece))
        if len(self._results) > AHEAD:
            self._take(self._results.popleft().result())

    def finish(self) -> None:
        """Take every result that is due."""
        while self._results:
            self._take(self._results.popleft().result())

    def stop(self) -> None:
        """End the threads and drop what is due; harmless when nothing is."""
        self._threads.shutdown(cancel_futures=True)
        self._results.clear()
