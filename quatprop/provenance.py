"""How a file came about, kept inside it: the key under which it stands, and how it is read.

The content is JSON: convention, layout, method, q0, source, policies, counts, versions. Files of
Arrow keep it in their metadata, text in a comment if that was requested.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

from quatprop.concurrency.threads import in_background
from quatprop.errors import DamagedLogError, UnreadableLogError, os_reason
from quatprop.settings.guarded_text import ContentError, read_json
from quatprop.text import MARK, in_python

JsonObject: TypeAlias = dict[str, Any]
"""An object of JSON, as it is read or about to be written."""

Entry = TypeVar("Entry")

_BLOCK_BYTES = 1 << 20
_PLAIN = (bool, int, float, str)

METADATA_KEY = b"quatprop"
"""Key of a file's metadata that holds the provenance, as JSON."""


COMMENT = b"# quatprop "
"""How the first line of a text begins that holds the provenance."""


def as_json(value: Any, spell: Callable[[str], str] = in_python) -> Any:
    """Return a value as JSON has it: the one place where reports and results become JSON.

    Dataclasses and named tuples become objects with their fields as keys (those of a digest among
    them) but for what ``repr`` leaves out, arrays and other sequences become lists, paths and
    strings; settings in sentences are spelled as in Python, or by `spell`. Numbers that are not
    finite become null.
    """
    if isinstance(value, float) and not math.isfinite(value):
        value = None  # JSON has no infinities.
    if value is None or isinstance(value, _PLAIN):
        return spell(value) if isinstance(value, str) and MARK in value else value
    if isinstance(value, Digest):
        return value.as_json()
    if (names := _names(value.__class__)) is not None:
        items = {name: as_json(getattr(value, name), spell) for name in names}
        # A digest says more about the same thing.
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
    """Return the fields of a dataclass that are shown, or of a named tuple; None of others."""
    if is_dataclass(record):
        return tuple(field.name for field in fields(record) if field.repr)
    return getattr(record, "_fields", None)


def provenance_in(text: bytes | str | None, path: Path | str) -> JsonObject:
    """Return the provenance that a file keeps; empty if there is none.

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
    """Return an entry of a provenance, empty where it has not the type that this package writes."""
    entry = provenance.get(name)
    return entry if isinstance(entry, kind) else kind()


def of_all_topics(custom: Mapping[str, str]) -> dict[str, str]:
    """Return the provenance of each topic, as JSON; under ``""`` that of all others."""
    named = {name.partition(" ")[::2]: text for name, text in custom.items()}
    return {topic: text for (key, topic), text in named.items() if key == METADATA_KEY.decode()}


class Digest(NamedTuple):
    """By what a source is recognised.

    `bytes`: its size; None if there is nothing that could be read again
    `sha256`: of its content; of a folder, of what ``sha256sum *`` prints for its files. None where
        it was not computed
    `files`: the files of a folder, by name; None for a file
    `etag`: by what an object store recognises its content; None for a file of this machine
    `changed`: when an object was written, as its store says it; not part of reports
    """

    bytes: int | None = None
    sha256: str | None = None
    files: Mapping[str, Digest] | None = None
    etag: str | None = None
    changed: str | None = None

    def as_json(self) -> JsonObject:
        """Return the digest as it stands in reports."""
        digest: JsonObject = {"bytes": self.bytes, "sha256": self.sha256}
        if self.etag is not None:
            digest["etag"] = self.etag
        if self.files is not None:
            digest["files"] = {name: file.as_json() for name, file in self.files.items()}
        return digest


def digest_of(path: Path | str) -> Digest:
    """Return the digest of a file or a folder; pipes and ``"-"`` cannot be read again."""
    return deque(_digest_at_end(Path(path), hashed=True), maxlen=1)[0] or Digest()


@contextmanager
def digest_ahead(path: Path | str, *, hashed: bool = True) -> Iterator[Callable[[], Digest]]:
    """Compute the digest of a source while others read it; yield what waits for it."""
    with closing(in_background(_digest_at_end(Path(path), hashed), ahead=None)) as steps:
        next(steps)  # starts it
        yield lambda: deque(steps, maxlen=1)[0] or Digest()


def _digest_at_end(path: Path, hashed: bool) -> Iterator[Digest | None]:
    """Yield None for whatever has been read, so that reading can be stopped, and the digest."""
    yield None
    try:
        if path.is_file():
            digest = yield from _of_file(path, hashed)
            yield digest
        elif path.is_dir() and (files := sorted(file for file in path.iterdir() if file.is_file())):
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
        # Memory costs time: a small file gets little.
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
