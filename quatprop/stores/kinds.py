"""All kinds of logs: one line of :data:`READERS` per kind.

The kind of a log is detected from content, then suffix; if neither is known, the log is refused
unless the user names the kind.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from quatprop.base.errors import (
    DamagedLogError,
    UnknownFormatError,
    UnreadableLogError,
    UnsupportedLogError,
    os_reason,
)
from quatprop.base.text import Setting

if TYPE_CHECKING:
    from pathlib import Path

    from quatprop.stores.file_source import FileSource

HEAD_BYTES = 4096
"""Bytes at the start of a file that identify its kind."""

_CONTROL = set(range(ord(" "))) - set(b"\t\r\n\f")
"""Bytes that do not occur in text."""


class Reader(NamedTuple):
    """How one kind of log is detected and opened.

    `load`: ``"module:Class"``, imported when a log of this kind is opened
    `magic`: possible first bytes; empty if only the suffix identifies it
    `suffixes`: suffixes that identify it if the content does not
    `reads_source`: whether it reads from an open
        :class:`~quatprop.stores.file_source.FileSource`; otherwise it opens the path itself
    """

    load: str
    magic: tuple[bytes, ...]
    suffixes: tuple[str, ...]
    reads_source: bool = False


READERS: dict[str, Reader] = {
    "mcap": Reader("quatprop.readers.containers.mcap:McapLog", (b"\x89MCAP",), (".mcap",), True),
    "bag": Reader(
        "quatprop.readers.containers.rosbag1:Rosbag1Log", (b"#ROSBAG V",), (".bag", ".active"), True
    ),
    "db3": Reader("quatprop.readers.containers.db3:Db3Log", (b"SQLite format 3\0",), (".db3",)),
    "rosbag2": Reader("quatprop.readers.containers.rosbag2:Rosbag2Log", (), ()),
    "ulog": Reader(
        "quatprop.readers.containers.ulog:UlogLog", (b"ULog\x01\x12\x35",), (".ulg",), True
    ),
    "parquet": Reader("quatprop.readers.tables.arrow:ParquetLog", (b"PAR1",), (".parquet",), True),
    "feather": Reader(
        "quatprop.readers.tables.arrow:FeatherLog",
        (b"ARROW1", b"FEA1", b"\xff\xff\xff\xff"),
        (".feather", ".arrow", ".arrows"),
        True,
    ),
    "npy": Reader("quatprop.readers.tables.numpy_table:NpyLog", (b"\x93NUMPY",), (".npy",)),
    "npz": Reader(
        "quatprop.readers.tables.numpy_table:NpzLog", (b"PK\x03\x04", b"PK\x05\x06"), (".npz",)
    ),
    "hdf5": Reader(
        "quatprop.readers.tables.hdf5:Hdf5Log",
        (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3"),
        (".h5", ".hdf5"),
    ),
    "matlab": Reader("quatprop.readers.tables.matlab:MatlabLog", (b"MATLAB 5.0",), (".mat",)),
    "jsonl": Reader(
        "quatprop.readers.tables.jsonl:JsonLinesLog",
        (b"{", b"\xef\xbb\xbf{"),
        (".jsonl", ".ndjson"),
    ),
    "tum": Reader("quatprop.readers.tables.csv:TumLog", (), (".tum",)),
    "kitti": Reader("quatprop.readers.tables.csv:KittiLog", (), (".kitti",)),
    "csv": Reader(
        "quatprop.readers.tables.csv:CsvLog", (), (".csv", ".tsv", ".txt", ".gcsv", ".dat")
    ),
}
"""Every kind of log, in the order in which errors and help list them."""

OTHER_FORMATS = {
    rb"version https://git-lfs": "it is a pointer of Git LFS; get the log with git lfs pull",
    rb"\xfd7zXZ\0|7z\xbc\xaf'\x1c|\x1f\x9d|Rar!": "it is an archive; unpack it",
    rb"(?s).{257}ustar": "it is a tar archive; unpack it, and name a log in it",
    rb"\xa3\x95\x80": "it is an ArduPilot log; convert it to CSV with mavlogdump.py",
    rb"H Product:Blackbox": "it is a Betaflight log; convert it with blackbox_decode",
    rb"\s*\[\s*[\[{]":
    "it is a JSON array; write one element per line, for example with jq -c '.[]'",
}  # fmt: skip
"""First bytes of unsupported formats -> what they are, and advice."""

COMPRESSION_SUFFIXES = (".gz", ".zst", ".zstd", ".lz4", ".bz2")
"""Suffixes of compressed files, after the suffix of the log."""

TEXT_KINDS = ("csv", "tum", "kitti")
"""Kinds that can be read as a stream, also compressed or from a pipe."""


def kind_of(path: Path, head: bytes) -> str:
    """Return the kind of a log by its first bytes, else by its suffix."""
    for kind, reader in READERS.items():
        if head.startswith(reader.magic):
            return kind
    for pattern, reason in OTHER_FORMATS.items():
        if re.match(pattern, head):
            raise UnsupportedLogError(path, reason)
    suffix = path.suffix.lower()
    for kind, reader in READERS.items():
        if suffix in reader.suffixes:
            if reader.magic and kind != "jsonl" and head.strip() and _is_text(head):
                raise UnsupportedLogError(
                    path,
                    f"it is text, and no log of kind {kind} in spite of its suffix; if it is a "
                    f"table, read it with {Setting('kind', 'csv')}",
                )
            return kind
    if _is_text(head):
        return "csv"
    if suffix in COMPRESSION_SUFFIXES:
        raise DamagedLogError(
            path,
            f"it does not begin like a {suffix} file; was it copied whole, or is it named wrongly?",
        )
    raise UnknownFormatError(
        path,
        "neither its content nor its suffix is one that this version reads; if you know "
        f"its kind, use {Setting('kind', '|'.join(READERS))}",
    )


def _is_text(head: bytes) -> bool:
    """Return whether bytes are text: UTF-8, possibly truncated, without control characters."""
    if set(head) & _CONTROL:
        return False
    try:
        head.decode()
    except UnicodeDecodeError as error:
        return error.start > len(head) - 4
    return True


def read_magic(source: FileSource) -> bytes:
    """Return the first bytes of a file."""
    try:
        head = source.read(0, HEAD_BYTES)
    except OSError as error:
        raise UnreadableLogError(source.path, os_reason(error)) from error
    if not head:
        raise UnreadableLogError(source.path, "the file is empty; was the recording closed?")
    return head
