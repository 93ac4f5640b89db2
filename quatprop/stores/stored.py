"""Identity of objects in a store, to detect whether a log was replaced."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.errors import ReplacedError
from quatprop.provenance import Digest
from quatprop.stores.objects import find, list_objects, locate, reading, without_secret
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pyarrow import NativeFile
    from pyarrow.fs import FileSystem


class StoredObject(NamedTuple):
    """Identity of an object.

    `name`: path below the requested prefix; empty for the object itself
    `size`: size, bytes
    `etag`: ETag of its content; None if the store has none
    `changed`: modification time, as text from the store
    `read`: MD5 digests of the whole content as read, which many stores use as ETag
    """

    name: str
    size: int
    etag: str | None
    changed: str
    read: list[str]

    @property
    def is_proved(self) -> bool:
        """Whether the content that was read matches the ETag, so no request is needed."""
        return self.etag in self.read


def stored_object(file: NativeFile, store: FileSystem, place: str, name: str = "") -> StoredObject:
    """Return the identity of an open object."""
    known = {
        str(key, "utf-8") if isinstance(key, bytes) else key: value.decode()
        for key, value in (file.metadata() or {}).items()
    }
    etag, changed = known.get("ETag"), known.get("Last-Modified")
    if changed is None:  # a local file system
        changed = str(store.get_file_info(place).mtime_ns)
    return StoredObject(name, file.size(), etag.strip('"') if etag else None, changed, [])


def objects_of(address: str, names: Iterable[str] = ("",)) -> list[StoredObject]:
    """Return the identities of objects below an address, or at it, by one request each."""
    objects = []
    with reading(address):
        store, place = locate(address)
        for name in names:
            path = f"{place}/{name}" if name else place
            with store.open_input_file(path) as file:
                objects.append(stored_object(file, store, path, name))
    return objects


class StoredLog:
    """Identity of a log in a store when it was opened.

    `address`: address of an object, or prefix of several
    `objects`: the objects read so far
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.objects: list[StoredObject] = []
        self._is_confirmed = False

    @property
    def digest(self) -> Digest:
        """Size and ETag of its object, or of all its objects."""
        digests = {
            one.name: Digest(one.size, etag=one.etag, changed=one.changed) for one in self.objects
        }
        if "" in digests:
            return digests[""]
        return Digest(sum(digest.bytes or 0 for digest in digests.values()), files=digests)

    def confirm(self) -> None:
        """Check once that the log was not replaced: Arrow's range requests have no If-Match."""
        if self._is_confirmed:
            return
        before = [one._replace(read=[]) for one in self.objects if not one.is_proved]
        if before != objects_of(self.address, [one.name for one in before]):
            raise ReplacedError(
                f"{plain(without_secret(self.address))}: it was replaced while it was read; try "
                "again when nobody writes it"
            )
        self._is_confirmed = True


def digest_of_object(address: str) -> Digest:
    """Return size and ETag of an object, or of all objects of a prefix."""
    found = find(address)[1]
    names = [""] if found.is_file else list(list_objects(address))
    log = StoredLog(address)
    log.objects += objects_of(address, names)
    return log.digest
