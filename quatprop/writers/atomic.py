"""Atomic output: a temporary file or folder that takes the target's place when it is complete.

A failed run leaves the old file as it was and nothing beside it. There is no fsync: after a power
cut a result can be computed again, and waiting for the disk would cost more than computing it.
Pipes and devices are written to directly, as there is nothing to replace. What goes to an object
store is made in the temporary folder, and becomes visible there when it is complete.
"""

from __future__ import annotations

import os
import stat
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

from quatprop.errors import OutputError
from quatprop.stores.objects import exists, is_address, split_address, without_secret
from quatprop.stores.temp_files import LockedTemp, NewFile, temp_file, temp_folder
from quatprop.writers.targets import checked_place, is_stdout, is_stream, output_errors

if TYPE_CHECKING:
    from collections.abc import Iterator


class OutputFile:
    """A file being written, to be committed or discarded.

    `target`: the file's path or address; ``"-"`` is stdout. Of a symbolic link, the file it points
        to is replaced and the link stays
    `stream`: binary stream. Buffered, since an unbuffered one may write only a part of what it is
        given
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
                # Appending: a file behind an open descriptor keeps what it has.
                self.stream = Path(target).open("ab")  # noqa: SIM115  # closed by commit or discard
        else:
            self._place = checked_place(target)
            with output_errors(target):
                self._temp = temp_file(self._place)
            self.stream = self._temp.made.stream

    def finish(self) -> None:
        """Close the stream; what is buffered is written, for which the disk may be too full."""
        with output_errors(self.target):
            self._close()

    def publish(self) -> None:
        """Put the finished file in its place."""
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
        """Close the stream and put the file in its place."""
        self.finish()
        self.publish()

    def discard(self) -> None:
        """Remove what was not committed; may be called twice."""
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
    """Open a binary stream whose bytes take the target's place at the end of the block."""
    output = OutputFile(target)
    try:
        with output_errors(target):
            yield output.stream
        output.commit()
    finally:
        output.discard()


def scratch_file(target: Path | str) -> BinaryIO:
    """Open a nameless temporary file for content whose beginning is not yet known."""
    import tempfile  # brings in much that few runs need

    in_temp_folder = is_stdout(target) or is_stream(target) or is_address(target)
    with output_errors(target):
        folder = None if in_temp_folder else Path(os.path.realpath(target)).parent
        return cast("BinaryIO", tempfile.TemporaryFile(dir=folder))


def _upload(path: Path, address: str) -> None:
    from quatprop.stores.transfers import upload  # brings in much that few runs need

    upload(path, address)


def _scratch_place() -> Path:
    """Return beside what temporary files are made that belong to no place."""
    import tempfile

    return Path(tempfile.gettempdir(), "outputs")


class OutputPath:
    """A temporary path for libraries that create files or folders by name.

    `target`: where the file or folder will be
    `folder`: whether it will be a folder. An old file is replaced; an old folder is refused,
        because replacing one cannot be done in one step
    `path`: where to create it: with the target's name, inside a temporary folder
    """

    def __init__(self, target: Path | str, *, folder: bool = False) -> None:
        self.target = without_secret(target)
        self._address = str(target) if is_address(target) else ""
        is_there = exists(self._address) if self._address else os.path.lexists(target)
        if folder and is_there:
            way_out = "choose another name, with a suffix unless it is to be a ROS 2 bag folder"
            raise OutputError(self.target, f"exists already; {way_out}")
        self._place = Path(split_address(self._address)[0])
        if not self._address:
            self._place = checked_place(target)
        with output_errors(self.target):
            self._temp = temp_folder(_scratch_place() if self._address else self._place)
        self.path = self._temp.path / self._place.name

    def finish(self) -> None:
        """Do nothing: whoever has created it has closed it."""

    def publish(self) -> None:
        """Put the finished file or folder in its place."""
        try:
            with output_errors(self.target):
                if self._address:
                    _upload(self.path, self._address)
                    return
                if self._place.exists():  # a file: folders replace nothing
                    self.path.chmod(stat.S_IMODE(self._place.stat().st_mode))
                self.path.replace(self._place)
        finally:
            self.discard()

    def discard(self) -> None:
        """Remove what was not committed; may be called twice."""
        self._temp.remove()
