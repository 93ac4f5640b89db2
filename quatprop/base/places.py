"""Names of files: paths, addresses of objects in a store, and streams."""

from __future__ import annotations

import re
import stat
from pathlib import Path
from urllib.parse import urlsplit

STDOUT = ("-", "/dev/stdout")
_DESCRIPTORS = ("/dev/stderr", "/dev/fd/", "/proc/self/fd/")
"""Names of open descriptors, which may be those of a regular file that must not be replaced."""


def is_address(path: Path | str) -> bool:
    """Return whether a path is an address such as ``s3://bucket/log.mcap``."""
    return "://" in str(path)


def without_file_scheme(path: str) -> str:
    """Return a ``file://`` address as a path, and others unchanged."""
    if not path.startswith("file://"):
        return path
    from urllib.request import url2pathname  # brings in much that few runs need

    return url2pathname(urlsplit(path).path)


def without_secret(path: Path | str) -> str:
    """Return a path or an address without credentials."""
    text = str(path)
    if text.startswith(("abfs://", "abfss://")):
        return re.sub(r"(?<=://)([^/?#:@]*):[^/?#]*@", r"\1@", text)
    return re.sub(r"(?<=://)[^/?#]*@", "", text) if is_address(text) else text


def is_stdout(target: Path | str) -> bool:
    """Return whether the target is standard output."""
    return str(target) in STDOUT


def is_stream(target: Path | str) -> bool:
    """Return whether the target is a pipe, a device or an open file rather than a file."""
    if str(target).startswith(_DESCRIPTORS):
        return True
    try:
        mode = Path(target).stat().st_mode
    except OSError:
        return False
    return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)
