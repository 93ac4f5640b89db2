"""Interruptions within destructors, where Python drops all exceptions."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from types import FrameType

_AGAIN_S = 0.01


def raise_interruptions_of_destructors() -> None:
    """Raise them again shortly after, in the main thread; not on Windows, which has no timer."""
    if hasattr(signal, "setitimer"):
        sys.unraisablehook = _raise_again


def _raise_again(unraisable: sys.UnraisableHookArgs) -> None:
    """Raise an interruption again that was dropped in a destructor."""
    error = unraisable.exc_value
    if not isinstance(error, KeyboardInterrupt | SystemExit):
        sys.__unraisablehook__(unraisable)
        return

    def raise_error(_number: int, _frame: FrameType | None) -> NoReturn:
        raise error

    signal.signal(signal.SIGALRM, raise_error)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
