"""Work done ahead of its use, in threads: reading and unpacking let other Python code run."""

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
"""One core is left to whoever uses the results."""

_WORTH = 2
"""Fewer threads than this gain nothing: one alone is slowed by handing over what it has done."""


@dataclass(frozen=True, slots=True)
class Deferred(Generic[Result]):
    """What is too large to wait for its use.

    Parameters
    ----------
    make
        Gives the result when its turn has come.
    """

    make: Callable[[], Result]


def prefetch(
    function: Callable[[Item], Result | Deferred[Result]], items: Sequence[Item]
) -> Generator[Result, None, None]:
    """Yield ``function(item)`` for each item, in order, computed a few items ahead.

    Close the iterator to stop early: what has begun is waited for, what has not is dropped.

    Parameters
    ----------
    function
        Called in other threads, several at a time; what it leaves for later is made when it is
        asked for, and not before.
    items
        What to call it with.

    Examples
    --------
    >>> list(prefetch(abs, [3, -1, -2, 0]))
    [3, 1, 2, 0]
    """
    if _WORKERS < _WORTH or len(items) <= 1 + _WORKERS:
        yield from (_now(function(item)) for item in items)
        return
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(_WORKERS)
    waiting: deque[Future[Result | Deferred[Result]]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) > _WORKERS:
                yield _now(waiting.popleft().result())
        while waiting:
            yield _now(waiting.popleft().result())
    finally:
        pool.shutdown(cancel_futures=True)


def _now(result: Result | Deferred[Result]) -> Result:
    return result.make() if isinstance(result, Deferred) else result
