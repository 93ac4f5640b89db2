"""The same work on many items, in processes of this machine; results in the order of the items."""

from __future__ import annotations

import multiprocessing
import signal
import sys
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from concurrent.futures import Future

Item = TypeVar("Item")
Result = TypeVar("Result")

KILLED = (
    "the process that ran it, or one beside it, was killed; is there enough memory? "
    "Run fewer at a time with -j"
)
"""Why there is no result of an item whose process has died."""


MOST_ON_WINDOWS = 61
"""Windows waits for 63 handles at a time, and two are taken."""


def workers(asked: int, items: int) -> int:
    """Return how many processes there are, for so many items."""
    most = MOST_ON_WINDOWS if sys.platform == "win32" else asked
    return min(asked, items, most)


def map_processes(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    processes: int,
    killed: Callable[[Item], Result],
    record: Callable[[Result], None] = lambda _result: None,
) -> Iterator[Result]:
    """Yield the result of each item, in their order, as soon as those before are done.

    Parameters
    ----------
    work
        What to do with an item; it, items and results pass between processes.
    items
        What to do it with.
    processes
        How many at a time; one is this process. The results are the same for any number.
    killed
        Makes the result of an item whose process was killed.
    record
        Called with each result as soon as it is there, which may be long before its turn.
    """
    if processes == 1 or len(items) <= 1:
        for item in items:
            result = work(item)
            record(result)
            yield result
        return
    # Processes start afresh, as everywhere but on Linux they must: no lock is copied half-taken.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(
        workers(processes, len(items)), context, signal.signal, (signal.SIGINT, signal.SIG_IGN)
    )
    try:
        futures = [pool.submit(_interruptible, work, item) for item in items]
        for future in futures:
            future.add_done_callback(partial(_recorded, record))
        for item, future in zip(items, futures, strict=True):
            try:
                yield future.result()
            except BrokenExecutor:
                yield killed(item)
    finally:
        pool.shutdown(cancel_futures=True)


def _recorded(record: Callable[[Result], None], future: Future[Result]) -> None:
    """Record the result of an item that came to its end."""
    if not future.cancelled() and future.exception() is None:
        record(future.result())


def _interruptible(work: Callable[[Item], Result], item: Item) -> Result:
    """Do something in a process that hears Ctrl-C only meanwhile.

    So the work ends tidily, and a process that waits for the next item does not end in a
    traceback.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return work(item)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
