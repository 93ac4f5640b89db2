"""Names beside a target for what is under way, and the end of those whose run was killed.

Whoever writes holds a lock on what it writes. What bears the name of the target's unfinished
files and is not locked belongs to nobody any more, and goes when the target is written next.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import weakref
from contextlib import suppress
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

T = TypeVar("T")


class Aside(Generic[T]):
    """A fresh file or folder beside a place, on the same disk, locked until it is removed or moved.

    Parameters
    ----------
    place
        Where it shall be in the end.
    make
        Makes the file or folder; fails where there is one.

    Attributes
    ----------
    path
        Where it is; the name is short, however long the target's is.
    made
        What making it gave.
    """

    def __init__(self, place: Path, make: Callable[[Path], T]) -> None:
        _sweep(place)
        while True:
            self.path = place.with_name(f"{_start(place)}{secrets.token_hex(4)}.part")
            # A signal may end the run between any two steps: what was made goes then, too.
            self._removal = weakref.finalize(self, _remove, self.path)
            self.made = make(self.path)
            self._lock = _locked(self.path, wait=True)
            # Another run may have swept it away before the lock was ours.
            if self.path.exists():
                break

    def remove(self) -> None:
        """Remove what is there, if it is, and let go of it; harmless the second time."""
        self._removal()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _start(place: Path) -> str:
    """Return what the names of a target's unfinished files begin with."""
    digest = hashlib.sha256(os.fsencode(place.name)).hexdigest()
    return f".quatprop-{digest[:8]}-"


def _sweep(place: Path) -> None:
    """Remove what killed runs have left of this target."""
    start = _start(place)
    for name in os.listdir(place.parent):  # noqa: PTH208  # names are all it takes
        if name.startswith(start):
            stray = place.with_name(name)
            lock = _locked(stray, wait=False)
            if lock is not None:
                _remove(stray)
                os.close(lock)


def _locked(path: Path, *, wait: bool) -> int | None:
    """Return a descriptor that locks a path; None where others have it, or nobody can."""
    try:
        import fcntl
    except ImportError:  # Windows: what a killed run leaves behind stays there
        return None
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink() if path.is_file() else shutil.rmtree(path)
