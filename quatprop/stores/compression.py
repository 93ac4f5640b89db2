"""Decompress chunks and messages in memory, and files piece by piece.

The sizes that a log declares are checked: at most :data:`MAX_SIZE` is allocated, and data with
another size than declared is refused.
"""

from __future__ import annotations

import os
import re
import threading
import zlib
from contextlib import suppress
from functools import cached_property, partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from quatprop.base.errors import UsageError
from quatprop.base.text import quoted
from quatprop.stores.temp_files import temp_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Buffer = bytes | bytearray | memoryview


MAX_SIZE = 1 << 30
"""Maximum decompressed size of a chunk or message, bytes."""

_PIECE = 1 << 20
"""Bytes decompressed at a time when streaming."""

_FEED = 1 << 12
"""Compressed bytes fed at a time: few, since the output of a damaged piece is lost, and zstd can
expand 4 bytes to 128 KiB."""

_GZIP = 16 + zlib.MAX_WBITS
"""Window bits with which zlib reads gzip."""


class UnreadableDataError(Exception):
    """Data that cannot be decompressed, or are invalid; readers add the place.

    `reason`: continues a sentence about the record, chunk, message or file
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def decompress(data: Buffer, compression: str, size: int | None = None) -> Buffer:
    """Return `data` decompressed.

    `compression`: ``""`` or ``"none"``, ``"lz4"`` (frame format), ``"zstd"`` or ``"bz2"``
    `size`: decompressed size declared by the log, bytes; None: not declared
    """
    decompressor = _DECOMPRESSORS.get(compression)
    if decompressor is None:
        raise UnreadableDataError(
            f"its compression {compression!r} is not one of none, lz4, zstd, bz2"
        )
    if size is None:
        return _undeclared(data, compression)
    if size > MAX_SIZE:
        raise UnreadableDataError(
            f"it declares {size} bytes decompressed, over the limit {MAX_SIZE}"
        )
    try:
        result = decompressor(data, size)
    except _decompression_errors(compression) as error:
        raise UnreadableDataError(f"its {compression} data is damaged") from error
    if len(result) != size:
        raise UnreadableDataError(f"it declares {size} bytes decompressed and holds {len(result)}")
    return result


def _undeclared(data: Buffer, compression: str) -> Buffer:
    """Decompress data of unknown size piece by piece, so that the limit holds."""
    if compression in {"", "none"}:
        return data
    result = bytearray()
    for piece in decompressed_pieces(BytesIO(data), compression):
        result += piece
        if len(result) > MAX_SIZE:
            raise UnreadableDataError(f"it decompresses to more than {MAX_SIZE} bytes")
    return result


def decompress_prefix(data: Buffer, compression: str, size: int) -> Buffer:
    """Return the start of truncated data, as far as it can be decompressed."""
    if compression in {"", "none"}:
        return data
    result = bytearray()
    limit = min(size, MAX_SIZE)
    if compression in _DECOMPRESSORS:
        with suppress(UnreadableDataError):
            for piece in decompressed_pieces(BytesIO(data), compression):
                result += piece
                if len(result) >= limit:
                    break
    return bytes(result[:limit])


class _Contexts(threading.local):
    """Decompression contexts: creating one costs more than decompressing a small chunk."""

    @cached_property
    def lz4(self) -> Any:
        import lz4.frame

        return lz4.frame.create_decompression_context()

    @cached_property
    def zstd(self) -> Any:
        import zstandard

        return zstandard.ZstdDecompressor()


_contexts = _Contexts()


def _decompress_lz4(data: Buffer, size: int) -> bytes:
    # lz4.frame.decompress creates a context for every call and trusts the size in the frame.
    import lz4.frame

    context = _contexts.lz4
    # After a damaged frame, the context is not reusable: no reset clears the declared size.
    del _contexts.lz4
    result, consumed, ended = lz4.frame.decompress_chunk(context, data, max_length=size)
    if consumed != len(data):
        raise _holds_more(size)
    if not ended:
        raise EOFError
    _contexts.lz4 = context
    return bytes(result)


def _decompress_zstd(data: Buffer, size: int) -> bytes:
    import zstandard

    in_frame = zstandard.frame_content_size(data)
    if in_frame not in {-1, size}:  # -1: not declared
        raise UnreadableDataError(f"it declares {size} bytes decompressed and holds {in_frame}")
    if size == 0:
        return b""
    return bytes(_contexts.zstd.decompress(data, max_output_size=size))


def _decompress_bz2(data: Buffer, size: int) -> bytes:
    import bz2

    stream = bz2.BZ2Decompressor()
    result = stream.decompress(data, max_length=size)
    if not stream.eof and stream.decompress(b"", max_length=1):
        raise _holds_more(size)
    if not stream.eof:
        raise EOFError
    return result


def _holds_more(size: int) -> UnreadableDataError:
    return UnreadableDataError(f"it declares {size} bytes decompressed and holds more")


_DECOMPRESSORS: dict[str, Callable[[Buffer, int], Buffer]] = {
    **dict.fromkeys(("", "none"), lambda data, _size: data),
    "lz4": _decompress_lz4,
    "zstd": _decompress_zstd,
    "bz2": _decompress_bz2,
}


def _decompression_errors(compression: str) -> tuple[type[Exception], ...]:
    """Return the exceptions of a compression library for damaged data."""
    if compression == "zstd":
        import zstandard

        return (zstandard.ZstdError, EOFError)
    # lz4 raises RuntimeError; bz2 and gzip OSError, EOFError or zlib.error.
    return (RuntimeError, OSError, EOFError, ValueError, zlib.error)


def decompressed_pieces(file: BinaryIO, compression: str) -> Iterator[bytes]:
    """Yield the decompressed content of `file` in pieces of bounded size."""
    try:
        if compression == "zstd":
            yield from _frames(file, _contexts.zstd.decompressobj)
        elif compression == "lz4":
            import lz4.frame

            yield from _frames(file, lz4.frame.LZ4FrameDecompressor, _PIECE)
        elif compression == "bz2":
            import bz2

            yield from _frames(file, bz2.BZ2Decompressor, _PIECE)
        elif compression == "zlib":
            yield from _frames(file, zlib.decompressobj)
        else:
            yield from _frames(file, partial(zlib.decompressobj, _GZIP), padding=b"\0")
    except _decompression_errors(compression) as error:
        raise UnreadableDataError(f"its {compression} data is damaged or cut off") from error


def _frames(
    file: BinaryIO, new_frame: Callable[[], Any], *limit: int, padding: bytes = b""
) -> Iterator[bytes]:
    # The file readers of the libraries accept truncated zstd files, and take a damaged second frame
    # of other formats as the end of the file.
    frame: Any = None
    data = b""
    while data or not getattr(frame, "needs_input", True) or (data := file.read(_FEED)):
        if frame is None:
            if not (data := data.lstrip(padding)):
                continue
            frame = new_frame()
        if piece := frame.decompress(data, *limit):
            yield piece
        data = b""
        if frame.eof:
            frame, data = None, frame.unused_data or b""
    if frame is not None:
        raise EOFError


# Limits for damaged and hostile logs, and environment variables that change them.
#
# The variables are for rare valid logs that exceed the limits; there are no parameters for them.


CHECKSUMS = "QUATPROP_CHECKSUMS"
"""Environment variable; ``ignore``: read chunks with a wrong checksum."""

MAX_UNPACKED = "QUATPROP_MAX_UNPACKED"
"""Environment variable: maximum decompressed size of a log, such as ``64G``."""

_LEAST = 2 << 30
_TIMES = 200
_BYTES = r"(?i)(\d{1,18})\s*([KMGT]?)I?B?"
_POWERS = {"": 0, "K": 10, "M": 20, "G": 30, "T": 40}


def checksums_matter() -> bool:
    """Return whether data with a wrong checksum are omitted."""
    return os.environ.get(CHECKSUMS, "").strip().lower() != "ignore"


class DecompressionBudget:
    """Counts decompressed bytes while a log is read, up to the limit.

    `size`: size of the file, bytes
    """

    def __init__(self, size: int) -> None:
        self._limit = decompressed_limit(size)
        self._spent = 0

    def check(self) -> None:
        """Raise an error if the limit is exceeded."""
        if self._spent > self._limit:
            raise UnreadableDataError(too_large(self._limit))

    def spend(self, size: int) -> None:
        """Count decompressed bytes."""
        self._spent += size


def decompressed_limit(size: int) -> int:
    """Return the maximum decompressed size of a log, bytes.

    It is the larger of 2 GiB and 200 times its size, unless the environment variable is set:
    recordings do not compress as well as files that are made to fill a disk.
    """
    value = os.environ.get(MAX_UNPACKED, "").strip()
    if not value:
        return max(_LEAST, _TIMES * size)
    number = re.fullmatch(_BYTES, value)
    if number is None:
        raise UsageError(
            f"{MAX_UNPACKED} is {quoted(value)}, which is not a number of bytes like 64G"
        )
    return int(number[1]) << _POWERS[number[2].upper()]


def too_large(limit: int) -> str:
    """Return the error for a log that exceeds the limit."""
    return (
        f"it decompresses to more than {limit} bytes; if that is right, set {MAX_UNPACKED} to more"
    )


# Compressed files, decompressed into a temporary copy.


_MAGIC = {
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\x04\x22\x4d\x18": "lz4",
    b"BZh": "bz2",
    b"\x1f\x8b": "gz",
}


MAGIC_BYTES = 64
"""Bytes at the start of a file that identify its compression."""

_SKIPPABLE = re.compile(rb"(?s)[\x50-\x5f]\x2a\x4d\x18(....)")


def file_compression(head: bytes) -> str:
    """Return the compression of a file by its first bytes; ``""``: none.

    Skippable frames may come first, as written by pzstd.

    References
    ----------
    RFC 8878, 3.1.2 "Skippable Frames"; those of LZ4 are the same.
    """
    while skipped := _SKIPPABLE.match(head):
        head = head[skipped.end() + int.from_bytes(skipped[1], "little") :]
        if not head:
            return "zstd"
    return next((name for magic, name in _MAGIC.items() if head.startswith(magic)), "")


class DecompressedCopy:
    """A decompressed temporary copy of a file compressed with zstd, lz4, bz2 or gzip.

    `path`: the temporary file, with the suffix of the log inside; of a damaged file, it holds the
        content before the damage
    `damage`: why the copy ends early, or ``""``
    """

    def __init__(self, path: Path) -> None:
        self.damage = ""
        with path.open("rb") as compressed:
            compression = file_compression(compressed.read(MAGIC_BYTES))
            if not compression:
                raise UnreadableDataError("it is not compressed with zstd, lz4, bz2 or gzip")
            compressed.seek(0)
            self._temp = temp_folder()
            self.path = self._temp.path / f"copy{Path(path.stem).suffix}"
            limit = decompressed_limit(path.stat().st_size)
            try:
                self._fill(decompressed_pieces(compressed, compression), limit)
            except BaseException:
                self.close()
                raise

    def _fill(self, pieces: Iterator[bytes], limit: int) -> None:
        """Write the pieces up to the end or to damage."""
        with self.path.open("wb") as copy:
            while True:
                try:
                    piece = next(pieces, b"")
                except UnreadableDataError as error:
                    if copy.tell() == 0:
                        raise
                    self.damage = error.reason
                    return
                if not piece:
                    return
                if copy.tell() + len(piece) > limit:
                    raise UnreadableDataError(too_large(limit))
                try:
                    copy.write(piece)
                    copy.flush()
                except OSError as error:
                    raise UnreadableDataError(
                        f"its decompressed copy does not fit into {self.path.parent} "
                        f"({error.strerror}); set TMPDIR to a folder with room"
                    ) from error

    def close(self) -> None:
        """Remove the temporary file."""
        self._temp.remove()
