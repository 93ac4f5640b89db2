"""Progress bars on a terminal."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from quatprop.progress import SHOW, Size

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tqdm import tqdm


DELAY_S = 0.5
"""Minimum duration for which a bar is shown, s."""


@contextmanager
def progress(*, quiet: bool = False) -> Iterator[None]:
    """Show progress in this block, if stderr is a terminal."""
    token = SHOW.set(_shown if on_terminal(quiet=quiet) else None)
    try:
        yield
    finally:
        SHOW.reset(token)


def on_terminal(*, quiet: bool = False) -> bool:
    """Return whether stderr is a terminal, and progress is not turned off."""
    # A process may have no stderr.
    return sys.stderr is not None and sys.stderr.isatty() and not quiet


def bar(total: int | None, unit: str, **options: Any) -> tqdm[Any]:
    """Return a progress bar on stderr, which disappears when closed."""
    from tqdm import tqdm

    # Its monitor thread would exist when processes are forked.
    tqdm.monitor_interval = 0
    return tqdm(total=total, unit=unit, leave=False, dynamic_ncols=True, **options)


def _shown(batches: Iterator[Any], total: int | None, size: Size) -> Iterator[Any]:
    began, done, shown = time.time(), 0, None
    try:
        for batch in batches:
            yield batch
            done += size(batch)
            if shown is None and time.time() - began > DELAY_S:
                shown = bar(total, " samples", unit_scale=True)
            if shown is not None:
                shown.update(done - shown.n)
    finally:
        if shown is not None:
            shown.close()
