"""Progress of reading a log, for an interface that sets :data:`SHOW`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextvars import ContextVar
from typing import Any, TypeAlias, TypeVar

Batch = TypeVar("Batch")

Show: TypeAlias = Callable[[Iterator[Any], int | None], Iterator[Any]]
"""Yields the batches of an iterator unchanged, and shows progress relative to a total."""

SHOW: ContextVar[Show | None] = ContextVar("SHOW", default=None)


def with_progress(batches: Iterator[Batch], total: int | None) -> Iterator[Batch]:
    """Return batches unchanged, with their progress shown by the interface, if it does.

    `total`: approximate number of samples; None: unknown
    """
    show = SHOW.get()
    return batches if show is None else show(batches, total)
