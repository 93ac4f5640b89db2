"""The logs of a batch, their names, and how a change of one is detected.

Paths are strings, since a batch may have a million.
"""

from __future__ import annotations

import hashlib
import os
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from quatprop.base.errors import StoreError
from quatprop.base.places import is_address, without_file_scheme, without_secret
from quatprop.base.times import NS_PER_S
from quatprop.stores.objects import below, find, list_objects, split_address

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pyarrow.fs import FileInfo

    from quatprop.base.provenance import Digest


class BatchTask(NamedTuple):
    """A log of a batch; small, as there may be a million.

    `root`: folder or address above it
    `log`: path below the root, with ``/``: the name under which the log is recorded
    `suffix`: suffix of the output
    `standing`: ``"log"``; ``"table"``: found in a folder, only a log if it has body rates; or
        ``"done"``: a log that an earlier batch has used
    `refused`: why it cannot be read; empty: no reason
    `origin`: size and time in the listing of a store; empty if not listed
    `topic`: topic to read, if the log is named as ``LOG:TOPIC`` or every topic is requested
    """

    root: str
    log: str
    suffix: str = ""
    standing: str = "log"
    refused: str = ""
    origin: str = ""
    topic: str = ""

    @property
    def path(self) -> str:
        """Path or address."""
        return place_below(self.root, self.log)

    @property
    def shown(self) -> str:
        """Path or address without credentials."""
        return without_secret(self.path)

    @property
    def label(self) -> str:
        """Path or address without credentials, as ``LOG:TOPIC`` if it has a topic."""
        return f"{self.shown}:{self.topic}" if self.topic else self.shown

    @property
    def name(self) -> str:
        """Path of its output in the folder of the batch: that of the log, with the suffix added.

        A topic follows the log, with ``/``; a zero byte, which no path may have, as ``%00``.
        """
        parts = self.topic.replace("\0", "%00").split("/")
        topic = (part for part in parts if part not in {"", ".", ".."})
        return "/".join([self.log, *topic]) + self.suffix

    def origin_now(self) -> str:
        """Return the size and time of the log; empty if unknown."""
        try:
            return self.origin or origin_of(self.path)
        except (OSError, StoreError):
            return ""


def place_below(root: str, name: str) -> str:
    """Return a path or address below a folder or an address."""
    if not name:
        return root
    return below(root, name) if is_address(root) else os.path.join(root, *name.split("/"))


def absolute(path: str) -> str:
    """Return an absolute path without following links, or an address without credentials."""
    if is_address(path):
        return split_address(without_secret(path))[0].rstrip("/")
    return os.path.abspath(path)


def real(path: str) -> str:
    """Return an absolute path with links followed, or an address without credentials."""
    return absolute(path) if is_address(path) else os.path.realpath(path)


# Origins: size and modification time of logs, to detect changes without reading them.


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
