"""The process that quatprop runs in: its memory, and interruptions in destructors."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from types import FrameType


def keep_freed_memory() -> None:
    """Let the C library keep up to 64 MB of freed memory, for quatprop's own processes.

    Returning the memory of chunks to the system, which clears its pages again, would take as long
    as decompressing them. glibc keeps twice the size of the largest block ever freed: this one.
    """
    bytes((1 << 25) - (1 << 13))


# Interruptions within destructors, where Python drops all exceptions.


_AGAIN_S = 0.01


def raise_interruptions_of_destructors() -> None:
    """Raise them again shortly after, in the main thread; not on Windows, which has no timer."""
    if sys.platform != "win32" and hasattr(signal, "setitimer"):
        alarm, start, timer = signal.SIGALRM, signal.setitimer, signal.ITIMER_REAL

        def raise_again(unraisable: sys.UnraisableHookArgs) -> None:
            error = unraisable.exc_value
            if not isinstance(error, KeyboardInterrupt | SystemExit):
                sys.__unraisablehook__(unraisable)
                return

            def raise_error(_number: int, _frame: FrameType | None) -> NoReturn:
                raise error

            signal.signal(alarm, raise_error)
            start(timer, _AGAIN_S)

        sys.unraisablehook = raise_again
