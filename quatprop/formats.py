"""Containers and tables: one file a format, one line of :data:`READERS` each.

The kind of a log is told by its content first and by its suffix second; what neither tells is
refused, with the option that settles it.
"""

from __future__ import annotations

import stat
import sys
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from quatprop.containers.compression import CompressionError
from quatprop.containers.packed_files import file_compression, unpacked_copy
from quatprop.containers.remote import is_address, local_copy, without_secret
from quatprop.errors import (
    DamagedLogError,
    LogError,
    UnknownFormatError,
    UnreadableLogError,
    UnsupportedLogError,
)
from quatprop.text import quoted
from quatprop.third_party_errors import as_errors_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.base import MessageLog
    from quatprop.containers.packed_files import UnpackedCopy
    from quatprop.tables.base import TableLog

HEAD_BYTES = 4096
"""How much of a file is looked at to tell its kind."""


_CONTROL = set(range(ord(" "))) - set(b"\t\r\n\f")
"""Bytes that no text has."""


class Reader(NamedTuple):
    """How one kind of log is told and opened.

    Parameters
    ----------
    load
        ``"module:Class"``, imported when a log of this kind is opened.
    magic
        What its content may begin with; empty where only the suffix tells.
    suffixes
        Suffixes that tell it where the content does not.
    """

    load: str
    magic: tuple[bytes, ...]
    suffixes: tuple[str, ...]


READERS: dict[str, Reader] = {
    "mcap": Reader("quatprop.containers.mcap.log:McapLog", (b"\x89MCAP",), (".mcap",)),
    "bag": Reader(
        "quatprop.containers.rosbag1.log:Rosbag1Log", (b"#ROSBAG V",), (".bag", ".active")
    ),
    "db3": Reader("quatprop.containers.rosbag2.db3:Db3Log", (b"SQLite format 3\0",), (".db3",)),
    "rosbag2": Reader("quatprop.containers.rosbag2.log:Rosbag2Log", (), ()),
    "ulog": Reader("quatprop.containers.ulog:UlogLog", (b"ULog\x01\x12\x35",), (".ulg",)),
    "parquet": Reader("quatprop.tables.arrow:ParquetLog", (b"PAR1",), (".parquet",)),
    "feather": Reader(
        "quatprop.tables.arrow:FeatherLog", (b"ARROW1", b"FEA1"), (".feather", ".arrow")
    ),
    "npy": Reader("quatprop.tables.npy:NpyLog", (b"\x93NUMPY",), (".npy",)),
    "npz": Reader("quatprop.tables.npz:NpzLog", (b"PK\x03\x04", b"PK\x05\x06"), (".npz",)),
    "jsonl": Reader("quatprop.tables.jsonl:JsonLinesLog", (b"{",), (".jsonl", ".ndjson")),
    "csv": Reader("quatprop.tables.csv.log:CsvLog", (), (".csv", ".tsv", ".txt", ".gcsv", ".dat")),
}
"""Every kind of log, in the order in which ``--from`` lists them."""


@contextmanager
def open_log(path: str | Path, kind: str | None = None) -> Iterator[MessageLog | TableLog]:
    """Open a log of any kind for the length of a ``with`` block.

    A log inside a file that was packed as a whole is unpacked into a temporary copy.

    Parameters
    ----------
    path
        A file, a ROS 2 bag folder, the address of one of them in an object store, or ``"-"`` for
        CSV on stdin.
    kind
        A key of :data:`READERS`; None means: told by the content, then by the suffix.

    Yields
    ------
    MessageLog or TableLog
        The open log.

    Raises
    ------
    UnreadableLogError
        The file is missing, empty or not permitted.
    UnknownFormatError
        Neither content nor suffix tells the kind.
    LogError
        The log is recognised but cannot be opened.
    """
    with as_errors_of(without_secret(path)), ExitStack() as stack:
        if str(path) == "-":
            if kind not in (None, "csv"):
                raise UnsupportedLogError("-", f"stdin is read as CSV, not as {kind}; name a file")
            log = _open("csv", sys.stdin.buffer)
            stack.enter_context(log)
            yield log
            return
        if is_address(path):
            copied = stack.enter_context(local_copy(str(path)))
            with _told_of(without_secret(path)):
                yield stack.enter_context(open_log(copied, kind))
            return
        path = Path(path)
        head = _head(path)
        if kind is not None and path.is_dir() != (kind == "rosbag2"):
            raise UnreadableLogError(
                path,
                f"a {'folder' if path.is_dir() else 'file'} is no log of kind {kind}; "
                "leave --from out, or name the log itself",
            )
        inside = path.with_suffix("") if path.suffix else path
        packed = file_compression(head)
        if packed and kind is None and inside.suffix.lower() in READERS["csv"].suffixes:
            kind = "csv"
        # A text table unpacks itself on the way, and its name may tell what it holds.
        if kind == "csv" or not packed:
            log = _open(kind or _kind(path, head), path)
            stack.enter_context(log)
            yield log
            return
        copy = stack.enter_context(_unpacked(path))
        with _told_of(path):
            log = _open(kind or _kind(inside, _head(copy.path)), copy.path)
            stack.enter_context(log)
            if copy.damage:
                log.losses.note("end of the file", copy.damage)
            yield log


def _open(kind: str, source: Path | BinaryIO) -> MessageLog | TableLog:
    module, _, name = READERS[kind].load.partition(":")
    try:
        log: MessageLog | TableLog = getattr(import_module(module), name)(source)
    except OSError as error:
        path = source if isinstance(source, Path) else Path("-")
        raise UnreadableLogError(path, _os_reason(error)) from error
    return log


def _unpacked(path: Path) -> UnpackedCopy:
    try:
        return unpacked_copy(path)
    except CompressionError as error:
        raise DamagedLogError(path, f"{error.reason}; unpack it by hand to see more") from error


@contextmanager
def _told_of(path: Path | str) -> Iterator[None]:
    """Let errors name the file the user knows, not the temporary copy."""
    try:
        yield
    except LogError as error:
        error.move_to(path)
        raise


def _kind(path: Path, head: bytes) -> str:
    if path.is_dir():
        return "rosbag2"
    for kind, reader in READERS.items():
        if head.startswith(reader.magic):
            return kind
    suffix = path.suffix.lower()
    for kind, reader in READERS.items():
        if suffix in reader.suffixes:
            return kind
    if _is_text(head):
        return "csv"
    raise UnknownFormatError(path, READERS)


def _is_text(head: bytes) -> bool:
    """Tell text from binary: UTF-8 (a character may be cut at the end) without control bytes."""
    if set(head) & _CONTROL:
        return False
    try:
        head.decode()
    except UnicodeDecodeError as error:
        return error.start > len(head) - 4
    return True


def _head(path: Path) -> bytes:
    """Return the first bytes of a file; a folder has none."""
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            return b""
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise UnreadableLogError(path, _os_reason(error)) from error
    if not head:
        raise UnreadableLogError(path, "the file is empty; was the recording closed?")
    return head


def _os_reason(error: OSError) -> str:
    match error:
        case FileNotFoundError():
            return "no such file or folder; check the path"
        case PermissionError():
            return "no permission to read it; check its owner and mode"
        case _:
            return f"it cannot be read: {quoted(error.strerror or error)}"
