"""Origins: size and modification time of logs, to detect changes without reading them."""

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
    """Return size and time of a log, for a folder with a digest over all its files."""
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
    # Message definitions may be in subfolders.
    inside = {*place.iterdir(), *place.rglob("*.msg")}
    return origin_of_parts((file.name, _of_file(file)) for file in inside if file.exists())


def origin_of_read(log: str, digest: Digest) -> str:
    """Return the origin of a log that was read from a store, usually without a request."""
    try:
        changed = datetime.fromisoformat(digest.changed or "")
    except ValueError:
        return origin_of(log)
    return f"{digest.bytes}:{int(changed.timestamp()) * NS_PER_S}"


def _of_file(file: Path) -> str:
    status = file.stat()
    return f"{status.st_size}:{status.st_mtime_ns}"


def origin_of_object(info: FileInfo) -> str:
    """Return size and time of an object, in whole seconds, as in listings."""
    return f"{info.size}:{(info.mtime_ns or 0) // NS_PER_S * NS_PER_S}"


def origin_of_parts(files: Iterable[tuple[str, str]]) -> str:
    """Return the total size and latest time of files, and a digest of their names and origins."""
    files = sorted(files)
    size = sum(int(origin.split(":")[0]) for _, origin in files)
    digest = hashlib.sha256(repr(files).encode(errors="surrogateescape")).hexdigest()
    return f"{size}:{max((changed_ns(origin) for _, origin in files), default=0)}:{digest[:16]}"


def changed_ns(origin: str) -> int:
    """Return the modification time in an origin, ns."""
    return int(origin.split(":")[1])
