"""Results computed ahead of their use, in threads: reading and decompressing release the GIL."""

from __future__ import annotations

import os
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence
    from concurrent.futures import Future

Item = TypeVar("Item")
Result = TypeVar("Result")

_WORKERS = max(1, min(3, (os.cpu_count() or 1) - 1))
"""One core is left to the consumer of the results."""

_MIN_WORKERS = 2
"""One thread alone gains nothing: handing over its results costs as much."""


@dataclass(frozen=True, slots=True)
class Deferred(Generic[Result]):
    """A result that is too large to be computed ahead of its use.

    Parameters
    ----------
    compute
        Computes the result when it is its turn.
    """

    compute: Callable[[], Result]


def prefetch(
    function: Callable[[Item], Result | Deferred[Result]], items: Sequence[Item]
) -> Generator[Result, None, None]:
    """Yield ``function(item)`` for each item, in order, computed a few items ahead.

    Close the iterator to stop early: calls that have begun are waited for, others are dropped.

    Parameters
    ----------
    function
        Called in other threads, several at a time; a result that it defers is computed in the
        caller's thread when it is its turn.
    items
        What to call it with.

    Examples
    --------
    >>> list(prefetch(abs, [3, -1, -2, 0]))
    [3, 1, 2, 0]
    """
    if _WORKERS < _MIN_WORKERS or len(items) <= 1 + _WORKERS:
        yield from (_computed(function(item)) for item in items)
        return
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(_WORKERS)
    waiting: deque[Future[Result | Deferred[Result]]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) > _WORKERS:
                yield _computed(waiting.popleft().result())
        while waiting:
            yield _computed(waiting.popleft().result())
    finally:
        pool.shutdown(cancel_futures=True)


def _computed(result: Result | Deferred[Result]) -> Result:
    return result.compute() if isinstance(result, Deferred) else result
