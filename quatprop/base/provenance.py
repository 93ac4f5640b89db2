"""Provenance of files: how it is stored and read; digests of sources.

It is JSON with convention, layout, method, q0, source, policies, counts and versions. Arrow files
have it in their metadata, text optionally in a comment.
"""

from __future__ import annotations

import hashlib
import math
import os
import stat
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

from quatprop.base.errors import DamagedLogError, UnreadableLogError, os_reason
from quatprop.base.guarded_text import ContentError, read_json
from quatprop.base.text import MARK, in_python
from quatprop.base.threads import in_background

JsonObject: TypeAlias = dict[str, Any]
"""A JSON object."""

Entry = TypeVar("Entry")

_BLOCK_BYTES = 1 << 20
_PLAIN = (bool, int, float, str)

METADATA_KEY = b"quatprop"
"""Metadata key of the provenance."""

COMMENT = b"# quatprop "
"""Start of the first line of a text with the provenance."""


def as_json(value: Any, spell: Callable[[str], str] = in_python) -> Any:
    """Convert a report or a result to JSON types.

    Dataclasses and named tuples become objects with their fields as keys, except fields without
    ``repr``; a digest is merged into the object around it. Arrays and other sequences become lists,
    and paths strings. Settings in sentences are spelled by `spell`. Non-finite numbers become null.
    """
    if isinstance(value, float) and not math.isfinite(value):
        value = None  # JSON has no infinities.
    if value is None or isinstance(value, _PLAIN):
        return spell(value) if isinstance(value, str) and MARK in value else value
    if isinstance(value, Digest):
        return value.as_json()
    if (names := _names(value.__class__)) is not None:
        items = {name: as_json(getattr(value, name), spell) for name in names}
        # A digest is merged into the object that it describes.
        digest = items.pop("digest", {})
        return {**items, **digest}
    if isinstance(value, list | tuple | set | frozenset):
        return [as_json(item, spell) for item in value]
    if isinstance(value, Mapping):
        return {str(key): as_json(item, spell) for key, item in value.items()}
    # NumPy's arrays and scalars, without importing NumPy.
    convert = getattr(value, "tolist", None)
    return str(value) if convert is None else convert()


@cache
def _names(record: type) -> tuple[str, ...] | None:
    """Return the fields of a dataclass with ``repr``, or of a named tuple; None for other types."""
    if is_dataclass(record):
        return tuple(field.name for field in fields(record) if field.repr)
    return getattr(record, "_fields", None)


def provenance_in(text: bytes | str | None, path: Path | str) -> JsonObject:
    """Return the provenance in a file; empty if there is none.

    `text`: the JSON; None if there is none
    """
    if text is None:
        return {}
    try:
        provenance = read_json(text)
    except ContentError:
        provenance = None
    if not isinstance(provenance, dict):
        raise DamagedLogError(
            path, "its metadata 'quatprop' is not the JSON it should be; write the file again"
        )
    return provenance


def entry_of(provenance: Mapping[str, Any], name: str, kind: type[Entry]) -> Entry:
    """Return an entry of a provenance; empty if it is missing or of another type."""
    entry = provenance.get(name)
    return entry if isinstance(entry, kind) else kind()


def of_all_topics(custom: Mapping[str, str]) -> dict[str, str]:
    """Return the provenance by topic, as JSON; under ``""`` that of all other topics."""
    named = {name.partition(" ")[::2]: text for name, text in custom.items()}
    return {topic: text for (key, topic), text in named.items() if key == METADATA_KEY.decode()}


class Digest(NamedTuple):
    """Identity of a source.

    `bytes`: size; None: it cannot be read again
    `sha256`: SHA-256 of its content, for a folder of the output of ``sha256sum *``; None: not
        computed
    `files`: files of a folder by name; None for a file
    `etag`: ETag in an object store; None for a local file
    `changed`: modification time of an object, as text from the store; not in reports
    """

    bytes: int | None = None
    sha256: str | None = None
    files: Mapping[str, Digest] | None = None
    etag: str | None = None
    changed: str | None = None

    def as_json(self) -> JsonObject:
        """Return the digest for reports."""
        digest: JsonObject = {"bytes": self.bytes, "sha256": self.sha256}
        if self.etag is not None:
            digest["etag"] = self.etag
        if self.files is not None:
            digest["files"] = {name: file.as_json() for name, file in self.files.items()}
        return digest


def digest_of(path: Path | str) -> Digest:
    """Return the digest of a file or a folder; empty for pipes and ``"-"``."""
    return deque(_digest_at_end(Path(path), hashed=True), maxlen=1)[0] or Digest()


@contextmanager
def background_digest(path: Path | str, *, hashed: bool = True) -> Iterator[Callable[[], Digest]]:
    """Compute the digest of a source in the background; yield a function that waits for it."""
    with closing(in_background(_digest_at_end(Path(path), hashed), ahead=None)) as steps:
        next(steps)  # starts it
        yield lambda: deque(steps, maxlen=1)[0] or Digest()


def _digest_at_end(path: Path, hashed: bool) -> Iterator[Digest | None]:
    """Yield None after each block, so that reading can be stopped, and finally the digest."""
    yield None
    try:
        mode = 0
        with suppress(FileNotFoundError, NotADirectoryError):
            mode = path.stat().st_mode  # is_file() passes over errors from Python 3.14 on
        if stat.S_ISREG(mode):
            digest = yield from _of_file(path, hashed)
            yield digest
        elif stat.S_ISDIR(mode) and (
            files := sorted(file for file in path.iterdir() if file.is_file())
        ):
            digests = {}
            for file in files:
                digests[file.name] = yield from _of_file(file, hashed)
            yield _of_folder(digests)
        else:
            yield None
    except OSError as error:
        raise UnreadableLogError(path, os_reason(error)) from error


def _of_file(file: Path, hashed: bool) -> Generator[None, None, Digest]:
    sha256 = hashlib.sha256()
    with file.open("rb", buffering=0) as stream:
        size = stream.seek(0, os.SEEK_END)
        if not hashed:
            return Digest(size)
        stream.seek(0)
        # Allocating memory takes time, so small files get a small buffer.
        block = memoryview(bytearray(max(1, min(size, _BLOCK_BYTES))))
        size = 0
        while count := stream.readinto(block):
            sha256.update(block[:count])
            size += count
            yield
    return Digest(size, sha256.hexdigest())


def _of_folder(files: Mapping[str, Digest]) -> Digest:
    size = sum(file.bytes or 0 for file in files.values())
    if any(file.sha256 is None for file in files.values()):
        return Digest(size)
    lines = "".join(f"{file.sha256}  {name}\n" for name, file in files.items())
    sha256 = hashlib.sha256(lines.encode(errors="surrogateescape"))
    return Digest(size, sha256.hexdigest(), files)
