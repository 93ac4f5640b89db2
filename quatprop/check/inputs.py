"""The files that a case depends on: their digests, and why these changed."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from quatprop.errors import LogError, UnreadableLogError
from quatprop.provenance import digest_of

DIGITS = 12
"""Digits of a SHA-256 that are shown."""

MAX_TEXT = 1 << 28
"""Bytes of a file up to which it is looked at whether only its line ends changed."""

_BAG_FILE = re.compile(r"metadata\.yaml|[^.].*\.(mcap|db3)(-wal|-journal|\.\w+)?|[^.].*\.(msg|idl)")
"""Names of the files of a bag that are read: parts, also compressed, journals and definitions;
desktops leave others there."""

LFS_POINTER = b"version https://git-lfs"
"""How a Git LFS pointer begins: the small file in place of one that was not downloaded."""


def digests_of(path: str) -> dict[str, str]:
    """Return the SHA-256 of a file, under ``""``, or of each file of a folder that is read.

    Raises
    ------
    LogError
        It is missing, unreadable, or a Git LFS pointer.
    """
    place = Path(path)
    if not place.is_dir():
        return {"": sha256_of(path)}
    return {
        file.name: sha256_of(str(file))
        for file in sorted(place.iterdir())
        if file.is_file() and _BAG_FILE.fullmatch(file.name)
    }


def describe_change(file: Path, old: str | None, new: str | None) -> str:
    """Return how a pinned file has changed, and the cause where it is known.

    Parameters
    ----------
    file
        The file.
    old, new
        Its SHA-256 when it was pinned, and now; None where there was or is none.
    """
    if old is None:
        return "it was not there when the reference was made"
    if new is None:
        return "it was there when the reference was made, and is missing"
    changed = "since the reference was made"
    if (ends := _line_ends_for(file, old)) is not None:
        return (
            f"only its line ends changed {changed}, {ends}: Git converts them; keep them with a "
            f"line '{file.name} -text' in .gitattributes, and check the file out again"
        )
    return f"its content changed {changed} (SHA-256 {old[:DIGITS]}, now {new[:DIGITS]})"


def _line_ends_for(file: Path, digest: str) -> str | None:
    """Return which line ends of a text changed; None where not only they did."""
    if file.stat().st_size > MAX_TEXT:
        return None
    content = file.read_bytes()
    unix = content.replace(b"\r\n", b"\n")
    for text, sentence in (
        (unix, "from LF to CRLF"),
        (unix.replace(b"\n", b"\r\n"), "from CRLF to LF"),
    ):
        if text != content and hashlib.sha256(text).hexdigest() == digest:
            return sentence
    return None


def sha256_of(path: str) -> str:
    """Return the SHA-256 of a file.

    Raises
    ------
    LogError
        It is missing, unreadable, or a Git LFS pointer.
    """
    refuse_lfs_pointer(path)
    digest = digest_of(path).sha256
    if digest is None:
        raise UnreadableLogError(path, "no such file or folder; check the path")
    return str(digest)


def refuse_lfs_pointer(path: str) -> None:
    """Refuse a Git LFS pointer in place of a file, or of a file in a folder.

    Raises
    ------
    LogError
        There is one.
    """
    place = Path(path)
    for file in sorted(place.iterdir()) if place.is_dir() else [place]:
        if file.is_file():
            with file.open("rb") as stream:
                if stream.read(len(LFS_POINTER)) == LFS_POINTER:
                    raise LogError(
                        file,
                        "it is a Git LFS pointer, not the file itself; download the file with "
                        "git lfs pull",
                    )
