"""How far the reading of a log has come, for an interface that shows it.

An interface sets :data:`SHOW` for the time of a run; without it, nothing happens here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextvars import ContextVar
from typing import Any, TypeAlias, TypeVar

Batch = TypeVar("Batch")

Size: TypeAlias = Callable[[Any], int]
"""Returns the number of samples in a batch."""

Show: TypeAlias = Callable[[Iterator[Any], int | None, Size], Iterator[Any]]
"""Yields the batches of an iterator as they are, and shows how many of a total have passed."""

SHOW: ContextVar[Show | None] = ContextVar("SHOW", default=None)


def with_progress(batches: Iterator[Batch], total: int | None, size: Size = len) -> Iterator[Batch]:
    """Return the batches, whose progress is shown where an interface does so.

    `total`: how many samples there are, at least roughly; None if that is not known
    """
    show = SHOW.get()
    return batches if show is None else show(batches, total, size)
