"""Temporary files next to a target, and removal of those left by killed runs.

A run locks its temporary files. One that is not locked belongs to a killed run, and is removed when
the target is written next. Folders may be shared between users: only files and folders of this user
are opened, and others cannot open those created here.
"""

from __future__ import annotations

import hashlib
import math
import os
import stat
import sys
import time
import weakref
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Generic, NamedTuple, TypeVar

try:  # once: an interruption as an import fails would keep what it leaves
    import fcntl
except ImportError:
    CAN_LOCK = False
else:
    CAN_LOCK = True

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

T = TypeVar("T")

_PREFIX = ".quatprop-"

MANY_FILES = 50
"""Maximum number of files in a folder that is listed for each output."""

RELIST_S = 60.0
"""Time for which the listing of a larger folder is cached, s."""

_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)

_OURS = {stat.S_IFREG, stat.S_IFDIR}

_LISTINGS: dict[Path, tuple[float, list[str]]] = {}
"""The time and the temporary files of the last listing of a large folder."""


class LockedTemp(Generic[T]):
    """A new file or folder next to a target, on the same disk, locked until removed or moved.

    `make`: creates the file or folder; fails if it exists
    `path`: its path; the name is short, even for a long target
    """

    def __init__(self, place: Path, make: Callable[[Path], T]) -> None:
        self._lock: int | None = None
        _remove_abandoned(place)
        while True:
            self.path = place.with_name(f"{_prefix(place)}{os.urandom(4).hex()}.part")
            # Registered first, so that a signal at any time leaves nothing behind.
            self._removal = weakref.finalize(self, _remove, self.path)
            self.made = make(self.path)
            self._lock = _lock(self.path, wait=True)
            # Another run may have removed it before it was locked.
            if self.path.exists():
                break
            self.remove()

    def remove(self) -> None:
        """Remove it if it exists, and unlock it; may be called twice, or interrupted."""
        _remove(self.path)
        self._removal.detach()
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)


def temp_folder(place: Path | None = None) -> LockedTemp[None]:
    """Return a new folder next to a place, or in the system's temporary folder.

    Folders left by killed runs are removed.
    """
    import tempfile

    place = place or Path(tempfile.gettempdir(), "copies")
    return LockedTemp(place, lambda path: path.mkdir(0o700))


class NewFile(NamedTuple):
    """A file that only this user can read until it is complete.

    `mode`: final mode: that of the file that it replaces, or of a new file there
    """

    stream: BinaryIO
    mode: int


def temp_file(place: Path) -> LockedTemp[NewFile]:
    """Return a new file next to a place, open for writing."""

    def make(path: Path) -> NewFile:
        mode = place.stat().st_mode if place.exists() else _usual_mode(path)
        file = os.open(path, _NEW, 0o600)
        return NewFile(os.fdopen(file, "wb"), stat.S_IMODE(mode))

    return LockedTemp(place, make)


def _usual_mode(path: Path) -> int:
    """Return the mode of a new file, by creating one: it depends on the umask and the folder."""
    file = os.open(path, _NEW, 0o666)
    try:
        return os.fstat(file).st_mode
    finally:
        os.close(file)
        path.unlink(missing_ok=True)  # whoever has opened it sees nothing of the next one


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock a file or folder for one run at a time; no effect if locks are not supported."""
    lock = _lock(path, wait=True)
    try:
        yield
    finally:
        if lock is not None:
            os.close(lock)


def _prefix(place: Path) -> str:
    """Return the prefix of the names of a target's temporary files."""
    digest = hashlib.sha256(os.fsencode(place.name)).hexdigest()
    return f"{_PREFIX}{digest[:8]}-"


def _remove_abandoned(place: Path) -> None:
    """Remove temporary files of this target that killed runs have left."""
    prefix = _prefix(place)
    for name in _names_in(place.parent):
        if name.startswith(prefix):
            path = place.with_name(name)
            lock = _lock(path, wait=False)
            if lock is not None:
                _remove(path)
                os.close(lock)


def _names_in(folder: Path) -> list[str]:
    """Return the names of temporary files in a folder; for a large one, up to a minute old.

    A batch may write thousands of outputs to one folder, which is not listed for each.
    """
    listed, temporary = _LISTINGS.get(folder, (-math.inf, []))
    if time.monotonic() - listed > RELIST_S:
        names = os.listdir(folder)  # noqa: PTH208  # only names are needed
        temporary = [name for name in names if name.startswith(_PREFIX)]
        if len(names) > MANY_FILES:
            _LISTINGS.clear()
            _LISTINGS[folder] = (time.monotonic(), temporary)
    return temporary


def _lock(path: Path, *, wait: bool) -> int | None:
    """Lock a path and return the descriptor; None if it is locked, or locks are not supported."""
    if sys.platform == "win32":
        return None  # files of killed runs remain
    else:  # noqa: RET505  # mypy skips a branch for another system, not what follows
        if not CAN_LOCK:
            return None
        try:
            # A pipe of this name would block, and a link may lead to one.
            descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
        except OSError:
            return None
        status = os.fstat(descriptor)
        if status.st_uid != os.geteuid() or stat.S_IFMT(status.st_mode) not in _OURS:
            os.close(descriptor)
            return None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError:
            os.close(descriptor)
            return None
        return descriptor


def _remove(path: Path) -> None:
    with suppress(OSError):
        if path.is_file():
            path.unlink()
        elif path.exists():
            import shutil

            shutil.rmtree(path)
