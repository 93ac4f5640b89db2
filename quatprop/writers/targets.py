"""Checks of output targets: files or streams, never an input or another output of the run."""

from __future__ import annotations

import os
import stat
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.base.errors import OutputError
from quatprop.base.places import is_address, is_stdout, is_stream, without_secret
from quatprop.base.text import plain
from quatprop.stores.objects import split_address

if TYPE_CHECKING:
    from collections.abc import Iterable

CASE_BLIND = sys.platform in {"darwin", "win32"}
"""Whether names that differ only in case are usually those of one file."""


def refuse_streams(target: Path | str, what: str) -> None:
    """Refuse pipes and devices for a format whose header is written last."""
    if is_stdout(target) or is_stream(target):
        raise OutputError(
            target,
            f"a pipe or a device cannot take {what}, whose beginning is written last; name a file",
        )


def checked_place(target: Path | str) -> Path:
    """Return the path that the target resolves to, if a file can be written there."""
    place = Path(os.path.realpath(target))
    if place.is_dir():
        raise OutputError(target, "is a folder; name a file in it")
    if not place.parent.is_dir():
        raise OutputError(target, f"there is no folder {place.parent}; create it first")
    if place.exists() and not (os.access(place, os.W_OK) and _has_write_bit(place)):
        raise OutputError(target, "this file is read-only; choose another")
    if not _has_write_bit(place.parent) or not os.access(place.parent, os.W_OK | os.X_OK):
        raise OutputError(
            target, f"writing in the folder {place.parent} is not permitted; choose another"
        )
    return place


def refuse_outside(target: Path | str, folder: Path | str) -> None:
    """Refuse a target outside a folder, also by way of a link in it; the folder may be a link."""
    place, root = os.path.realpath(target), os.path.realpath(folder)
    if not Path(place).is_relative_to(root):
        raise OutputError(
            target,
            f"it leads to {plain(place)}, which is outside {plain(root)}; remove the link or the "
            "path that leads there",
        )


def _has_write_bit(place: Path) -> bool:
    """Return whether anybody may write: root must not replace read-only files either."""
    return bool(place.stat().st_mode & (stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH))


class _OutputErrors:
    """A block in which errors of the system become an :class:`OutputError`.

    Not a generator: in CPython 3.11 an interruption as one ends can keep alive the objects that
    the block has made, and so their temporary files.
    """

    __slots__ = ("_known", "_target")

    def __init__(self, target: Path | str, known: tuple[type[Exception], ...]) -> None:
        self._target, self._known = target, known

    def __enter__(self) -> None:
        """Begin the block."""

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """Raise another error for one that is known."""
        if isinstance(error, self._known) and not isinstance(error, BrokenPipeError):
            reason = getattr(error, "strerror", None) or error
            raise OutputError(self._target, f"cannot be written: {reason}") from error


def output_errors(target: Path | str, *others: type[Exception]) -> _OutputErrors:
    """Turn errors of the operating system into an :class:`OutputError` that names the target.

    BrokenPipeError is not changed: a reader may close the pipe early.
    """
    return _OutputErrors(target, (OSError, *others))


def refuse_overlap(inputs: Iterable[str | None], outputs: Iterable[str | None]) -> None:
    """Refuse outputs that would replace an input or another output of the run.

    The time is linear in the number of names, since a batch has many.

    `inputs`: files and folders that are read, with all files in the folders; None is skipped
    `outputs`: targets of results; None is skipped, and so are streams
    """
    targets = [name for name in outputs if name is not None]
    if sum(map(is_stdout, targets)) > 1:
        raise OutputError("-", "two outputs of the run would go to stdout; name a file for one")
    real_folder = cache(os.path.realpath)

    def real(name: str) -> str:
        # Many names are in few folders: the links of each folder are followed once.
        folder, file = os.path.split(name)
        if file in {"", os.curdir, os.pardir} or os.path.islink(name):  # noqa: PTH114
            return os.path.realpath(name)
        return os.path.join(real_folder(folder), file)  # noqa: PTH118

    sources, identities = set[str](), set[tuple[int, int]]()
    for source in inputs:
        if source and is_address(source):
            sources.add(_object(source))
        elif source and (identity := _identity(source)):
            sources.add(real(source))
            identities.add(identity)

    @cache
    def source_above(folder: str) -> str | None:
        above = os.path.dirname(folder)  # noqa: PTH120
        return folder if folder in sources else None if above == folder else source_above(above)

    written = set[str]()
    for name in targets:
        if is_stdout(name) or is_stream(name):
            continue
        place = _object(name) if is_address(name) else real(name)
        if place in sources or _identity(place) in identities:
            raise OutputError(
                without_secret(name), "this is an input of the run; choose another output"
            )
        if above := source_above(os.path.dirname(place)):  # noqa: PTH120
            raise OutputError(
                name, f"this is in {plain(above)}, which is an input; choose another output"
            )
        key = place.lower() if CASE_BLIND and not is_address(name) else place
        if key in written:
            raise OutputError(name, "two outputs of the run would go here; choose another")
        written.add(key)


def _object(address: str) -> str:
    """Return an address without secrets and parameters."""
    return split_address(without_secret(address))[0].rstrip("/")


def _identity(name: str) -> tuple[int, int] | None:
    """Return the identity of a file, the same for all its names; None if it does not exist."""
    try:
        status = os.stat(name)  # noqa: PTH116  # no object a name
    except OSError:
        return None
    return status.st_dev, status.st_ino
