"""Interruption of the command line: Ctrl-C, and requests to end.

A command that is interrupted removes its temporary files and ends with 130, or with 143 or 129
where it is told to end. Handlers of signals belong to the whole process, so that they are set here
and nowhere else.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

from quatprop.concurrency.destructors import raise_interruptions_of_destructors

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

INTERRUPTED = 130
MESSAGE = "Interrupted."


def handle_signals() -> None:
    """Handle signals for a run of the command line."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # What is ignored from outside, as by nohup, stays ignored.
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end)
    if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
        signal.signal(signal.SIGINT, _exit_at_once)
    raise_interruptions_of_destructors()


@contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C raise KeyboardInterrupt in this block, where there is something to tidy up.

    Outside of it the process ends at once: while modules are imported, the exception could come
    where nobody expects it. Does nothing where :func:`handle_signals` was not called.
    """
    if signal.getsignal(signal.SIGINT) is not _exit_at_once:
        yield
        return
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, _exit_at_once)


def _end(number: int, _frame: FrameType | None) -> NoReturn:
    os.write(2, f"Ended by {signal.Signals(number).name}.\n".encode())
    sys.exit(128 + number)


def _exit_at_once(_number: int, _frame: FrameType | None) -> None:
    os.write(2, f"{MESSAGE}\n".encode())
    os._exit(INTERRUPTED)
