"""The lock of a suite: a JSON file that pins the inputs, options and results of its cases.

It is text, so that a review shows which log, option or reference has changed, and by how much: a
reference is binary, and an independent series cannot hold such a record. Files are pinned by their
digests; this module also finds out why a digest has changed.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.base.errors import LogError, SuiteError, UnreadableLogError
from quatprop.base.guarded_text import ContentError, read_bytes, read_json
from quatprop.base.provenance import JsonObject, as_json, digest_of
from quatprop.base.text import Setting
from quatprop.writers.atomic import write_atomic

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping

FORMAT = 2
"""Version of the format of a lock."""

MAX_LOCK = 1 << 27
"""Largest lock that is read, bytes; a case needs about a thousand."""

_CONFLICT = re.compile("(<{7}|={7}|>{7})( .*)?")
"""A conflict marker of a merge."""


class Pin(NamedTuple):
    """Inputs and results of a case when it was last updated.

    `quatprop`: the version that did the update
    `inputs`: key of the suite -> SHA-256 of the file that it names; in a folder each file that is
        read has its own, by key and name
    `span_s`: time from the first sample to the last, s
    `final_deg`: roll, pitch and yaw of the attitude at the last sample, deg
    `total_angle_deg`: total angle traversed, deg
    `remarks`: codes of the remarks on the log and the reference, sorted
    `every`: the reference holds every N-th attitude; None if the case has settings for that
    `reference`: SHA-256 of the stored reference; None if there is none
    `measured`: the errors against an independent series, deg, after the alignment, and the value of
        each limit, by its key; empty for a stored reference
    `alignment`: the rotations that align an independent series, wxyz, by name, those that its
        alignment does not fit left out; empty without alignment and for a stored reference
    """

    quatprop: str
    inputs: Mapping[str, str]
    options: Mapping[str, str]
    samples: int
    span_s: float
    final_deg: Mapping[str, float]
    total_angle_deg: float
    remarks: tuple[str, ...]
    every: int | None
    reference: str | None
    measured: Mapping[str, float]
    alignment: Mapping[str, tuple[float, ...]]


def _is_count(value: object) -> bool:
    return type(value) is int and value > 0


def _is_text_table(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(text, str) for text in value.values())


def _is_number(value: object) -> bool:
    return type(value) in {int, float}


def _is_number_table(value: object) -> bool:
    return isinstance(value, dict) and all(map(_is_number, value.values()))


def _is_wxyz(value: object) -> bool:
    return isinstance(value, list) and len(value) == 4 and all(map(_is_number, value))  # noqa: PLR2004


FRAMES = ("reference", "body")
"""Frames of an independent series that an alignment turns."""

IS_VALID: Mapping[str, Callable[[Any], bool]] = {
    "quatprop": lambda value: isinstance(value, str),
    "inputs": _is_text_table,
    "options": _is_text_table,
    "samples": _is_count,
    "span_s": _is_number,
    "final_deg": lambda value: _is_number_table(value) and set(value) == {"roll", "pitch", "yaw"},
    "total_angle_deg": _is_number,
    "remarks": lambda value: isinstance(value, list) and all(isinstance(x, str) for x in value),
    "every": lambda value: value is None or _is_count(value),
    "reference": lambda value: value is None or isinstance(value, str),
    "measured": _is_number_table,
    "alignment": lambda value: (
        isinstance(value, dict) and value.keys() <= {*FRAMES} and all(map(_is_wxyz, value.values()))
    ),
}
"""Field of :class:`Pin` -> whether a value in the lock is valid."""


def read_lock(path: Path, *, anew: bool = False) -> dict[str, Pin]:
    """Return the pin of each case; empty if there is no lock yet.

    `anew`: also return nothing for a lock in another format, since it is about to be replaced
    """
    if not path.exists():
        return {}
    refuse_lfs_pointer(str(path))
    try:
        content = read_bytes(path, MAX_LOCK)
    except ContentError as error:
        raise SuiteError(path, str(error)) from error
    if line := conflict_line(content):
        remedy = "remove the markers, keeping one side of each case, and check with "
        reason = f"line {line} is a conflict marker of a merge; {remedy}{Setting('update')}"
        raise SuiteError(path, reason)
    try:
        lock = read_json(content)
        if lock.get("format") != FORMAT and isinstance(lock["cases"], dict):
            if anew:
                return {}
            reason = "the lock was written by an older format; run check with "
            raise SuiteError(path, f"{reason}{Setting('update')}, which lists what it replaces")
        return {name: pin_of(entry) for name, entry in lock["cases"].items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        why = f" ({error})" if isinstance(error, ContentError) else ""
        reason = f"it is not the lock that {Setting('update')} writes{why}; restore it"
        raise SuiteError(path, f"{reason}, or remove it and update") from error


def conflict_line(content: bytes) -> int | None:
    """Return the line of the first conflict marker, from 1; None if there is none."""
    lines = content.decode(errors="replace").splitlines()
    return next(
        (number for number, line in enumerate(lines, 1) if _CONFLICT.fullmatch(line.strip())), None
    )


def pin_of(entry: JsonObject) -> Pin:
    """Return an entry of a lock as a pin."""
    if entry.keys() != IS_VALID.keys() or not all(IS_VALID[key](entry[key]) for key in IS_VALID):
        raise ValueError(entry)
    alignment = {frame: tuple(wxyz) for frame, wxyz in entry["alignment"].items()}
    return Pin(**{**entry, "remarks": tuple(entry["remarks"]), "alignment": alignment})


def merge_into_lock(
    suite: Path, path: Path, pins: Mapping[str, Pin], deleted: Collection[str]
) -> None:
    """Write the pins of cases into the lock, and keep the other pins.

    The lock is read again, since another update may have written it meanwhile. Each case is a
    block of lines, so that changes of two cases merge.
    """
    with _exclusive(suite):
        old = read_lock(path, anew=True)
        kept = {name: pin for name, pin in old.items() if name not in deleted}
        cases = dict(sorted({**kept, **pins}.items()))
        content = as_json({"format": FORMAT, "cases": cases})
        text = (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()
        if path.exists() and path.read_bytes() == text:
            return
        write_atomic(path, text)


@contextmanager
def _exclusive(suite: Path) -> Iterator[None]:
    """Exclude other updates, where the system can lock the suite."""
    with suite.open("rb") as stream:
        if sys.platform != "win32":
            with suppress(ImportError, OSError):  # some network file systems
                import fcntl

                fcntl.flock(stream, fcntl.LOCK_EX)
        yield


DIGITS = 12
"""Digits of a SHA-256 that are shown."""

MAX_SEARCHED = 1 << 32
"""Most bytes that are hashed to find a missing file under another name."""

MAX_TEXT = 1 << 28
"""Largest file that is checked for changed line ends, bytes."""

_BAG_FILE = re.compile(r"metadata\.yaml|[^.].*\.(mcap|db3)(-wal|-journal|\.\w+)?|[^.].*\.(msg|idl)")
"""Files of a bag that are hashed: parts, also compressed, journals and message definitions;
file managers add others, such as thumbnails."""

LFS_POINTER = b"version https://git-lfs"
"""First bytes of a Git LFS pointer, the small file in place of one that was not downloaded."""


def digests_of(path: str) -> dict[str, str]:
    """Return the SHA-256 of a file, under ``""``, or of the files of a bag, by name."""
    place = Path(path)
    if not place.is_dir():
        return {"": sha256_of(path)}
    # Message definitions may be in packages below.
    return {
        file.relative_to(place).as_posix(): sha256_of(str(file))
        for file in sorted({*place.iterdir(), *place.rglob("*.msg")})
        if file.is_file() and _BAG_FILE.fullmatch(file.name)
    }


def describe_change(file: Path, old: str | None, new: str | None) -> str:
    """Return how a pinned file has changed, and the cause if known.

    `old`, `new`: the pinned and the current SHA-256; None if there was or is no file
    """
    if old is None:
        return "it did not exist when the reference file was made"
    if new is None:
        return "it existed when the reference file was made, and is missing"
    changed = "since the reference file was made"
    if (ends := _line_end_change(file, old)) is not None:
        return (
            f"only its line ends changed {changed}, {ends}: Git converts them; keep them with a "
            f"line '{file.name} -text' in .gitattributes, and check the file out again"
        )
    return f"its content changed {changed} (SHA-256 {old[:DIGITS]}, now {new[:DIGITS]})"


def _line_end_change(file: Path, digest: str) -> str | None:
    """Return the change of line ends; None if anything else changed."""
    if file.stat().st_size > MAX_TEXT:
        return None
    content = file.read_bytes()
    unix = content.replace(b"\r\n", b"\n")
    before = {"from LF to CRLF": unix, "from CRLF to LF": unix.replace(b"\n", b"\r\n")}
    for change, text in before.items():
        if text != content and hashlib.sha256(text).hexdigest() == digest:
            return change
    return None


def sha256_of(path: str) -> str:
    """Return the SHA-256 of a file."""
    refuse_lfs_pointer(path)
    digest = digest_of(path).sha256
    if digest is None:
        raise UnreadableLogError(path, "no such file or folder; check the path")
    return str(digest)


def with_content(folder: Path, pattern: str, digest: str | None) -> Path | None:
    """Return the first matching file of a folder with a given SHA-256; None if there is none."""
    remaining = MAX_SEARCHED
    with suppress(OSError):
        for other in filter(Path.is_file, sorted(folder.glob(pattern))):
            remaining -= other.stat().st_size
            if remaining > 0 and digest_of(other).sha256 == digest:
                return other
    return None


def refuse_lfs_pointer(path: str) -> None:
    """Refuse a Git LFS pointer in place of a file."""
    if Path(path).is_file():
        with Path(path).open("rb") as stream:
            if stream.read(len(LFS_POINTER)) == LFS_POINTER:
                raise LogError(
                    path,
                    "it is a Git LFS pointer, not the file itself; download the file with git lfs "
                    "pull",
                )
