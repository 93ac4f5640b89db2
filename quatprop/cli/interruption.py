"""Signals on the command line: Ctrl-C, SIGTERM and SIGHUP.

An interrupted command removes its temporary files and exits with 130 (SIGINT), 143 (SIGTERM) or 129
(SIGHUP). Signal handlers are global to the process, so only the command line sets them.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

from quatprop.base.own_process import raise_interruptions_of_destructors

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

INTERRUPTED = 130
MESSAGE = "Interrupted."


def handle_signals() -> None:
    """Set the signal handlers of the command line."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # Signals that are ignored, as by nohup, stay ignored.
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end)
    if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
        signal.signal(signal.SIGINT, _exit_at_once)
    raise_interruptions_of_destructors()


@contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C raise KeyboardInterrupt in this block, for cleanup.

    Outside the block, the process ends at once, since imports are not safe to interrupt. Without
    :func:`handle_signals`, this does nothing.
    """
    if signal.getsignal(signal.SIGINT) is _exit_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, _exit_at_once)
    else:
        yield


def _end(number: int, _frame: FrameType | None) -> NoReturn:
    os.write(2, f"Ended by {signal.Signals(number).name}.\n".encode())
    sys.exit(128 + number)


def _exit_at_once(_number: int, _frame: FrameType | None) -> None:
    os.write(2, f"{MESSAGE}\n".encode())
    os._exit(INTERRUPTED)
