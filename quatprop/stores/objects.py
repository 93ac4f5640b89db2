"""Object stores: files by address, and errors as one sentence.

A store is any file system with an address that Arrow supports: ``s3://``, ``gs://``, ``abfs://``,
``hdfs://``, ``file://``.
"""

from __future__ import annotations

import os
import re
from contextlib import contextmanager
from functools import lru_cache
from textwrap import shorten
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import parse_qs, quote, unquote, urlsplit

from quatprop.base.errors import ReplacedError, StoreError, UsageError
from quatprop.base.places import is_address, without_secret
from quatprop.base.provenance import Digest
from quatprop.base.text import plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from pyarrow import NativeFile
    from pyarrow.fs import FileInfo, FileSystem


RETRY_S = 10
"""Timeout for retries if a store does not answer, s."""

ATTEMPTS = 8
"""Number of attempts of an S3 request, unless ``AWS_MAX_ATTEMPTS`` is set.

The pauses double; those of eight attempts outlast an overload of 5 s.
"""

ANONYMOUS = "anonymous"
"""User name for unsigned requests, as in ``s3://anonymous@bucket``."""

MAX_REASON = 240
"""Maximum length of a store library's message that is shown; the rest is repetition."""

S3_PARAMETERS = {"endpoint_override", "region", "scheme", "tls_ca_file_path"}
"""Parameters of an S3 address; any other ``?`` is part of a key."""

_TRANSIENT = (
    r"NETWORK_CONNECTION|curlCode|REQUEST_TIMEOUT|SLOW_DOWN|SERVICE_UNAVAILABLE|resolve host"
    r"|HTTP status (?:429|5\d\d)\b"
)
"""Pattern for messages of store libraries on errors that may be temporary."""

_REASONS = (
    (
        r"Unrecognized filesystem type",
        "unknown kind of store; addresses begin with s3://, gs://, abfs:// or hdfs://",
    ),
    (
        r"OAuth2 access token|AuthenticationException",
        "no credentials for its store were found; log in with the store's own tools",
    ),
    (
        r"SLOW_DOWN|SERVICE_UNAVAILABLE|HTTP status (?:429|5\d\d)\b",
        "the store is overloaded; try again later, or with fewer processes",
    ),
    (r"NO_SUCH_BUCKET|Bucket '.*' not found", "no such bucket; check the address"),
    (
        r"ACCESS_DENIED|INVALID_ACCESS_KEY|SIGNATURE_DOES_NOT_MATCH|\b40[13]\b|[Pp]ermission",
        "its store does not permit that; check the credentials and their rights",
    ),
    (
        _TRANSIENT,
        "its store does not answer; check the network and the address of the store",
    ),
)
"""Pattern for messages of store libraries -> reason and advice for the user."""


def split_address(address: str) -> tuple[str, str]:
    """Return an address without its parameters, and the parameters."""
    base, _, query = address.partition("?")
    if address.startswith("s3://"):
        base, query = _S3_PARAMETERS.fullmatch(address).groups("")  # type: ignore[union-attr]
    return base, query


_S3_PARAMETER = rf"(?:{'|'.join(sorted(S3_PARAMETERS))})=[^&]*"
_S3_PARAMETERS = re.compile(rf"(?s)(.*?)(?:\?({_S3_PARAMETER}(?:&{_S3_PARAMETER})*))?")


def below(address: str, name: str) -> str:
    """Return the address of an object below another one, with the same parameters.

    `name`: its key below the address, which may contain ``?``
    """
    base, query = split_address(address)
    if not address.startswith("s3://"):
        name = quote(name, errors="surrogateescape")
    return f"{base.rstrip('/')}/{name}{'?' if query else ''}{query}"


def has_address(address: str, name: str) -> bool:
    """Return whether a key below an address is valid: Arrow does not accept empty parts."""
    parts = {*name.split("/")}
    if parts & {"", ".", ".."} or "\0" in name:
        return False
    return not address.startswith("s3://") or split_address(below(address, name))[0].endswith(name)


def locate(address: str) -> tuple[FileSystem, str]:
    """Return the store of an address, and the path of the object in it.

    Credentials that are not in the address are found as by the store's own tools.
    """
    base, query = split_address(address)
    if address.startswith("s3://"):
        host, slash, path = base.removeprefix("s3://").partition("/")
        user, _, bucket = host.rpartition("@")
        return _s3(user, bucket, query), f"{bucket}{slash}{path}".rstrip("/")
    from pyarrow.fs import FileSystem

    store, place = FileSystem.from_uri(_with_retry_limit(address))
    return store, place


@lru_cache(maxsize=16)
def _s3(user: str, bucket: str, query: str) -> FileSystem:
    """Return the store of a bucket, with limited retries."""
    from pyarrow.fs import AwsDefaultS3RetryStrategy, S3FileSystem, resolve_s3_region

    options: dict[str, object] = {name: values[-1] for name, values in parse_qs(query).items()}
    if user == ANONYMOUS:
        options["anonymous"] = True
    elif user:
        key, _, secret = user.partition(":")
        options |= {"access_key": unquote(key), "secret_key": unquote(secret)}
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL")
    if endpoint and "endpoint_override" not in options:
        parts = urlsplit(endpoint)
        options |= {"endpoint_override": parts.netloc, "scheme": parts.scheme}
    region = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
    if "region" not in options and (region or "endpoint_override" not in options):
        options["region"] = region or resolve_s3_region(bucket)
    attempts = os.environ.get("AWS_MAX_ATTEMPTS", "")
    return S3FileSystem(
        connect_timeout=RETRY_S,
        request_timeout=RETRY_S,
        allow_delayed_open=True,
        retry_strategy=AwsDefaultS3RetryStrategy(
            max_attempts=int(attempts) if attempts.isdecimal() else ATTEMPTS
        ),
        **options,
    )


def _with_retry_limit(address: str) -> str:
    """Return an address with limited retries: by default, gs:// retries for 15 minutes."""
    if not address.startswith(("gs://", "gcs://")) or "retry_limit_seconds" in address:
        return address
    return f"{address}{'&' if '?' in address else '?'}retry_limit_seconds={RETRY_S}"


def is_transient(error: BaseException) -> bool:
    """Return whether an error of a store may be temporary."""
    return re.search(_TRANSIENT, str(error.__cause__)) is not None


def store_reason(error: Exception, address: str) -> str:
    """Return the reason of a store's error, and advice."""
    if isinstance(error, FileNotFoundError):
        return "no such object; check the address"
    message = str(error)
    detail = shorten(
        plain(message.replace(address, without_secret(address))), MAX_REASON, placeholder="..."
    )
    for pattern, reason in _REASONS:
        if re.search(pattern, message):
            what, _, remedy = reason.partition("; ")
            return f"{what} ({detail}); {remedy}"
    return f"its store cannot be used ({detail}); check the address and access"


@contextmanager
def reading(address: str) -> Iterator[None]:
    """Convert errors of a store to a StoreError that names the object."""
    from pyarrow import ArrowException

    try:
        yield
    except (OSError, ValueError, ArrowException) as error:
        raise StoreError(
            f"{plain(without_secret(address))}: {store_reason(error, address)}"
        ) from error


def find(address: str) -> tuple[FileSystem, FileInfo]:
    """Return the store, and the object or prefix at an address."""
    from pyarrow.fs import FileType

    with reading(address):
        store, place = locate(address)
        found = store.get_file_info(place)
        if found.type == FileType.NotFound:
            raise FileNotFoundError(address)
    return store, found


def exists(address: str) -> bool:
    """Return whether there is an object at or below an address."""
    try:
        find(address)
    except StoreError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return False
        raise
    return True


def list_objects(address: str, *, missing_ok: bool = False) -> dict[str, FileInfo]:
    """Return all objects below an address, as path -> object, sorted by path."""
    from pyarrow.fs import FileSelector

    with reading(address):
        store, place = locate(address)
        selector = FileSelector(place, allow_not_found=missing_ok, recursive=True)
        found = {str(info.path): info for info in store.get_file_info(selector) if info.is_file}
    top = len(place.rstrip("/")) + 1
    return {path[top:]: found[path] for path in sorted(found)}


# Names of logs that may include a topic: ``LOG:TOPIC``.


def split_topic(name: str, given: str | None = None) -> tuple[str, str | None]:
    """Return the path and the topic of a log, unless a file has the whole name.

    The topic of an address begins with a slash, since ports and keys also have colons.

    `given`: the topic of a setting; a different one in the name is refused
    """
    pattern = re.compile(":(?=/[^/])" if is_address(name) else ":(?=.)")
    colons = list(pattern.finditer(name, len(os.path.splitdrive(name)[0])))
    if not colons or _is_there(name):
        return name, given
    ends = (colon.start() for colon in colons if _is_there(name[: colon.start()]))
    if (end := next(ends, None)) is None:
        return name, given
    topic = name[end + 1 :]
    if given not in (None, topic):
        raise UsageError(
            f"{plain(without_secret(name))}: another topic is given, {quoted(given)}; name one"
        )
    return name[:end], topic


def split_topics(names: Iterable[str], given: str | None = None) -> tuple[list[str], str | None]:
    """Return the paths of the files of one log and their topic; see :func:`split_topic`."""
    paths = []
    for name in names:
        path, given = split_topic(name, given)
        paths.append(path)
    return paths, given


def _is_there(name: str) -> bool:
    if is_address(name):
        return exists(name)
    # False, not an error, if a name is too long.
    return os.path.exists(name)  # noqa: PTH110


# Identity of objects in a store, to detect whether a log was replaced.


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
                "again when it is no longer being written"
            )
        self._is_confirmed = True


def digest_of_object(address: str) -> Digest:
    """Return size and ETag of an object, or of all objects of a prefix."""
    found = find(address)[1]
    names = [""] if found.is_file else list(list_objects(address))
    log = StoredLog(address)
    log.objects += objects_of(address, names)
    return log.digest
