"""Atomic output: a temporary file or folder that replaces the target when it is complete.

A failed run leaves the old file unchanged and no other file. There is no fsync: after a power cut
a result can be computed again, and waiting for the disk would take longer than computing it. Pipes
and devices are written directly. Output to an object store is written to a temporary file, and
uploaded when it is complete.
"""

from __future__ import annotations

import os
import stat
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

from quatprop.base.errors import OutputError
from quatprop.base.places import is_address, is_stdout, is_stream, without_secret
from quatprop.stores.objects import exists, split_address
from quatprop.stores.temp_files import LockedTemp, NewFile, temp_file, temp_folder
from quatprop.writers.targets import checked_place, output_errors

if TYPE_CHECKING:
    from collections.abc import Iterator


class OutputFile:
    """A file being written, to be committed or discarded.

    `target`: the file's path or address; ``"-"`` is stdout. A symbolic link is followed: the file
        is replaced and the link is kept
    `stream`: binary stream, buffered, since an unbuffered one may write only a part of its input
    """

    def __init__(self, target: Path | str) -> None:
        self.target = without_secret(target)
        self._temp: LockedTemp[NewFile] | None = None
        self._address = str(target) if is_address(target) else ""
        if self._address:
            with output_errors(self.target):
                self._temp = temp_file(_scratch_place())
            self.stream: BinaryIO = self._temp.made.stream
        elif is_stdout(target):
            if sys.stdout is None:
                raise OutputError(target, "standard output is closed; name a file")
            sys.stdout.flush()
            self.stream = sys.stdout.buffer
        elif is_stream(target):
            with output_errors(target):
                # Appended: a file behind an open descriptor keeps its content.
                self.stream = Path(target).open("ab")  # noqa: SIM115  # closed by commit or discard
        else:
            self._place = checked_place(target)
            with output_errors(target):
                self._temp = temp_file(self._place)
            self.stream = self._temp.made.stream

    def finish(self) -> None:
        """Flush and close the stream, which may fail if the disk is full."""
        with output_errors(self.target):
            self._close()

    def publish(self) -> None:
        """Replace the target with the finished file."""
        try:
            with output_errors(self.target):
                if self._temp is not None and self._address:
                    _upload(self._temp.path, self._address)
                elif self._temp is not None:
                    self._temp.path.chmod(self._temp.made.mode)
                    self._temp.path.replace(self._place)
        finally:
            self.discard()

    def commit(self) -> None:
        """Close the stream and replace the target."""
        self.finish()
        self.publish()

    def discard(self) -> None:
        """Discard uncommitted output; may be called twice."""
        with suppress(OSError):
            self._close()
        if self._temp is not None:
            self._temp.remove()
            self._temp = None

    def _close(self) -> None:
        if is_stdout(self.target):
            self.stream.flush()  # stdout is closed by its owner
        else:
            self.stream.close()


@contextmanager
def open_atomic(target: Path | str) -> Iterator[BinaryIO]:
    """Open a binary stream that replaces the target at the end of the block."""
    output = OutputFile(target)
    try:
        with output_errors(target):
            yield output.stream
        output.commit()
    finally:
        output.discard()


def write_atomic(target: Path | str, content: str | bytes) -> None:
    """Replace the target by text or bytes."""
    with open_atomic(target) as stream:
        stream.write(content.encode() if isinstance(content, str) else content)


def scratch_file(target: Path | str) -> BinaryIO:
    """Open an anonymous temporary file for content whose header is not known yet."""
    import tempfile  # brings in much that few runs need

    in_temp_folder = is_stdout(target) or is_stream(target) or is_address(target)
    with output_errors(target):
        folder = None if in_temp_folder else Path(os.path.realpath(target)).parent
        return cast("BinaryIO", tempfile.TemporaryFile(dir=folder))


def _upload(path: Path, address: str) -> None:
    from quatprop.stores.remote import upload  # brings in much that few runs need

    upload(path, address)


def _scratch_place() -> Path:
    """Return a path in the folder for temporary files of uploads."""
    import tempfile

    return Path(tempfile.gettempdir(), "outputs")


class OutputPath:
    """A temporary path for libraries that create files or folders by name.

    `target`: path or address of the file or folder
    `folder`: whether it is a folder. An old file is replaced; an old folder is refused, because it
        cannot be replaced atomically
    `path`: where to create it: with the target's name, in a temporary folder
    """

    def __init__(self, target: Path | str, *, folder: bool = False) -> None:
        self.target = without_secret(target)
        self._address = str(target) if is_address(target) else ""
        is_there = exists(self._address) if self._address else os.path.lexists(target)
        if folder and is_there:
            remedy = "choose another name, with a suffix unless it is to be a ROS 2 bag folder"
            raise OutputError(self.target, f"exists already; {remedy}")
        self._place = Path(split_address(self._address)[0])
        if not self._address:
            self._place = checked_place(target)
        with output_errors(self.target):
            self._temp = temp_folder(_scratch_place() if self._address else self._place)
        self.path = self._temp.path / self._place.name

    def finish(self) -> None:
        """Do nothing: the library that created it has closed it."""

    def publish(self) -> None:
        """Replace the target with the finished file or folder."""
        try:
            with output_errors(self.target):
                if self._address:
                    _upload(self.path, self._address)
                    return
                if self._place.exists():  # a file: folders are never replaced
                    self.path.chmod(stat.S_IMODE(self._place.stat().st_mode))
                self.path.replace(self._place)
        finally:
            self.discard()

    def discard(self) -> None:
        """Discard uncommitted output; may be called twice."""
        self._temp.remove()
