"""By what it is told, without reading it, that a log is another one than before."""

from __future__ import annotations

import hashlib
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.stores.objects import find, is_address, list_objects, without_file_scheme
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pyarrow.fs import FileInfo

    from quatprop.provenance import Digest


def origin_of(log: str) -> str:
    """Return size and time of a log, and for a folder a digest of those of all its files."""
    log = without_file_scheme(log)
    if is_address(log):
        found = find(log)[1]
        if found.is_file:
            return origin_of_object(found)
        files = list_objects(log).items()
        own = ((name, origin_of_object(info)) for name, info in files if "/" not in name)
        return origin_of_parts(own)
    place = Path(log)
    if not place.is_dir():
        return _of_file(place)
    # Definitions of messages may be in packages below.
    inside = {*place.iterdir(), *place.rglob("*.msg")}
    return origin_of_parts((file.name, _of_file(file)) for file in inside if file.exists())


def origin_of_read(log: str, digest: Digest) -> str:
    """Return the same of a log that was read from a store, which as a rule is not asked again."""
    try:
        changed = datetime.fromisoformat(digest.changed or "")
    except ValueError:
        return origin_of(log)
    return f"{digest.bytes}:{int(changed.timestamp()) * NS_PER_S}"


def _of_file(file: Path) -> str:
    status = file.stat()
    return f"{status.st_size}:{status.st_mtime_ns}"


def origin_of_object(info: FileInfo) -> str:
    """Return size and time of an object; a listing may have the time in whole seconds only."""
    return f"{info.size}:{(info.mtime_ns or 0) // NS_PER_S * NS_PER_S}"


def origin_of_parts(files: Iterable[tuple[str, str]]) -> str:
    """Return the size and the latest time of files, by name and origin, and a digest of these."""
    files = sorted(files)
    size = sum(int(origin.split(":")[0]) for _, origin in files)
    digest = hashlib.sha256(repr(files).encode(errors="surrogateescape")).hexdigest()
    return f"{size}:{max((changed_ns(origin) for _, origin in files), default=0)}:{digest[:16]}"


def changed_ns(origin: str) -> int:
    """Return when a log was written last, ns."""
    return int(origin.split(":")[1])
