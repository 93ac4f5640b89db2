"""Nothing half-written: output goes aside and takes the target's place when it is complete.

A failed run leaves the old file as it was and nothing beside it. There is no fsync: after a power
cut a result can be computed again, and waiting for the disk would cost more than computing it.
Pipes and devices are written to as they are; there is nothing to replace.
"""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, cast

from quatprop.errors import OutputError
from quatprop.writers.temp_files import Aside

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import BinaryIO, Self

STDOUT = ("-", "/dev/stdout")
_DESCRIPTORS = ("/dev/stderr", "/dev/fd/", "/proc/self/fd/")
"""Names of open files: behind them may be a regular file, which is not ours to replace."""


def is_stdout(target: Path | str) -> bool:
    """Return whether the target means standard output."""
    return str(target) in STDOUT


def is_stream(target: Path | str) -> bool:
    """Return whether the target is a pipe, a device or an open file rather than a file."""
    if str(target).startswith(_DESCRIPTORS):
        return True
    try:
        mode = Path(target).stat().st_mode
    except OSError:
        return False
    return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


def refuse_streams(target: Path | str, what: str) -> None:
    """Refuse pipes and devices for a format whose beginning is written last.

    Raises
    ------
    OutputError
        The target is one.
    """
    if is_stdout(target) or is_stream(target):
        raise OutputError(
            target,
            f"a pipe or a device cannot take {what}, whose beginning is written last; name a file",
        )


@contextmanager
def reported(target: Path | str) -> Iterator[None]:
    """Turn errors of the system into an :class:`OutputError` that names the target.

    A closed pipe passes as it is: that the reader of our output has gone is not an error.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(target, f"cannot be written: {error.strerror or error}") from error


class Output:
    """A file being written, to be committed or to vanish.

    Parameters
    ----------
    target
        Where the file shall be; ``"-"`` is stdout. Of a symbolic link, the file it points to is
        replaced and the link stays.

    Attributes
    ----------
    stream
        Binary stream. Buffered, since an unbuffered one may take part of a block and leave the
        rest to a caller who does not ask.

    Raises
    ------
    OutputError
        The target is a folder, its folder does not exist, or writing is not permitted.
    """

    def __init__(self, target: Path | str) -> None:
        self.target = target
        self._aside: Aside[BinaryIO] | None = None
        if is_stdout(target):
            sys.stdout.flush()
            self.stream: BinaryIO = sys.stdout.buffer
        elif is_stream(target):
            with reported(target):
                # Appending: a file behind an open descriptor keeps what it has.
                self.stream = Path(target).open("ab")  # noqa: SIM115  # closed by commit or discard
        else:
            self._place = checked_place(target)
            with reported(target):
                self._aside = Aside(self._place, lambda path: path.open("xb"))
            self.stream = self._aside.made

    def commit(self) -> None:
        """Close the stream and put the file in its place."""
        try:
            with reported(self.target):
                self._close()
                if self._aside is not None:
                    if self._place.exists():
                        self._aside.path.chmod(stat.S_IMODE(self._place.stat().st_mode))
                    self._aside.path.replace(self._place)
        finally:
            self.discard()

    def discard(self) -> None:
        """Remove what was not committed; harmless when there is nothing."""
        with suppress(OSError):
            self._close()
        if self._aside is not None:
            self._aside.remove()
            self._aside = None

    def _close(self) -> None:
        if is_stdout(self.target):
            self.stream.flush()  # stdout is closed by its owner
        else:
            self.stream.close()


@contextmanager
def replacing(target: Path | str) -> Iterator[BinaryIO]:
    """Give a binary stream whose bytes take the target's place at the end of the block.

    Raises
    ------
    OutputError
        As for :class:`Output`, and where the disk is full.
    """
    output = Output(target)
    try:
        with reported(target):
            yield output.stream
        output.commit()
    finally:
        output.discard()


def scratch(target: Path | str) -> BinaryIO:
    """Open a nameless file for what must wait until its beginning is known.

    Parameters
    ----------
    target
        Where the content will go in the end. The file is on the same disk, which has to have
        room for the content anyway.
    """
    elsewhere = is_stdout(target) or is_stream(target)
    with reported(target):
        folder = None if elsewhere else Path(os.path.realpath(target)).parent
        return cast("BinaryIO", tempfile.TemporaryFile(dir=folder))


class Replacement:
    """A path beside the target for libraries that insist on a path of their own.

    Parameters
    ----------
    target
        Where the file or folder shall be.
    folder
        It will be a folder. An old file is replaced; a folder only comes to be where nothing is,
        because replacing one cannot be done in one step.

    Attributes
    ----------
    path
        Where to create it; it has the target's name, inside a folder that will vanish.

    Raises
    ------
    OutputError
        As for :class:`Output`; or the folder is there already.
    """

    def __init__(self, target: Path | str, *, folder: bool = False) -> None:
        self.target = target
        if folder and os.path.lexists(target):
            raise OutputError(target, "exists already; remove it or choose another name")
        self._place = checked_place(target)
        with reported(target):
            self._aside = Aside(self._place, lambda path: path.mkdir())
        self.path = self._aside.path / self._place.name

    def commit(self) -> None:
        """Put the finished file or folder in its place."""
        try:
            with reported(self.target):
                self.path.replace(self._place)
        finally:
            self.discard()

    def discard(self) -> None:
        """Remove what was not committed; harmless when there is nothing."""
        self._aside.remove()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.discard()


def checked_place(target: Path | str) -> Path:
    """Return where the file will be, after refusing places where it cannot be.

    Raises
    ------
    OutputError
        The target is a folder, its folder does not exist, or writing is not permitted.
    """
    place = Path(os.path.realpath(target))
    if place.is_dir():
        raise OutputError(target, "is a folder; name a file in it")
    if not place.parent.is_dir():
        raise OutputError(target, f"there is no folder {place.parent}; create it first")
    if place.exists() and not (os.access(place, os.W_OK) and _is_unlocked(place)):
        raise OutputError(target, "this file is read-only; choose another")
    if not _is_unlocked(place.parent) or not os.access(place.parent, os.W_OK | os.X_OK):
        raise OutputError(
            target, f"writing in the folder {place.parent} is not permitted; choose another"
        )
    return place


def _is_unlocked(place: Path) -> bool:
    """Tell whether anybody may write: what is marked read-only is meant to stay, for root too."""
    return bool(place.stat().st_mode & (stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH))
