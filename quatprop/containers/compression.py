"""Unpacking chunks and messages in memory, and streams piece by piece.

What a log says about the size of its unpacked data is checked, not believed: nothing is allocated
beyond :data:`MAX_SIZE`, and data that unpacks to another size than declared is refused.
"""

from __future__ import annotations

import threading
import zlib
from contextlib import suppress
from functools import cached_property
from io import BytesIO
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Buffer = bytes | bytearray | memoryview

MAX_SIZE = 1 << 30
"""Bytes that one chunk or message may unpack to."""

LARGE = 1 << 26
"""Bytes of a chunk of which no second is unpacked ahead of its use."""

_PIECE = 1 << 20
"""Bytes that are unpacked at a time when streaming."""

_ZSTD_FEED = 1 << 12
"""Packed bytes given to zstd at a time: four of them can unpack to 128 KiB, and it has no limit."""


class CompressionError(Exception):
    """Packed data that cannot be unpacked; readers add the place.

    Parameters
    ----------
    reason
        What is wrong, as the end of a sentence about the chunk, message or file.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def decompress(data: Buffer, compression: str, size: int | None = None) -> Buffer:
    """Return `data` unpacked.

    Parameters
    ----------
    data
        One chunk or message.
    compression
        ``""`` or ``"none"``, ``"lz4"`` (frame format), ``"zstd"`` or ``"bz2"``.
    size
        The unpacked size in bytes as the log declares it; None where it declares none.

    Returns
    -------
    bytes or memoryview
        Exactly `size` bytes; `data` itself where it is not packed.

    Raises
    ------
    CompressionError
        The data is damaged, of another size than declared, or larger than :data:`MAX_SIZE`, or
        the compression is unknown.

    Examples
    --------
    >>> import bz2
    >>> decompress(bz2.compress(b"0.1 rad/s"), "bz2", 9)
    b'0.1 rad/s'
    """
    unpack = _UNPACK.get(compression)
    if unpack is None:
        raise CompressionError(
            f"its compression {compression!r} is not one of none, lz4, zstd, bz2"
        )
    if size is None:
        return _undeclared(data, compression)
    if size > MAX_SIZE:
        raise CompressionError(f"it declares {size} bytes unpacked, over the limit of {MAX_SIZE}")
    try:
        unpacked = unpack(data, size)
    except damage_of(compression) as error:
        raise CompressionError(f"its {compression} data is damaged") from error
    if len(unpacked) != size:
        raise CompressionError(f"it declares {size} bytes unpacked and holds {len(unpacked)}")
    return unpacked


def _undeclared(data: Buffer, compression: str) -> Buffer:
    """Unpack data of unknown size piece by piece, so that the limit holds."""
    if compression in {"", "none"}:
        return data
    unpacked = bytearray()
    try:
        for piece in pieces(BytesIO(data), compression):
            unpacked += piece
            if len(unpacked) > MAX_SIZE:
                raise CompressionError(f"it unpacks to more than the limit of {MAX_SIZE} bytes")
    except damage_of(compression) as error:
        raise CompressionError(f"its {compression} data is damaged") from error
    return unpacked


def front(data: Buffer, compression: str, size: int) -> Buffer:
    """Return what can be unpacked of data whose end is missing.

    Parameters
    ----------
    data
        The beginning of a chunk.
    compression
        As for :func:`decompress`.
    size
        Bytes that the whole chunk unpacks to, as the log declares it.

    Returns
    -------
    bytes or memoryview
        At most `size` bytes, and at most :data:`MAX_SIZE`; empty where nothing can be unpacked.
    """
    if compression in {"", "none"}:
        return data
    unpacked = bytearray()
    most = min(size, MAX_SIZE)
    if compression in _UNPACK:
        with suppress(*damage_of(compression)):
            for piece in pieces(_Trickle(data), compression):
                unpacked += piece
                if len(unpacked) >= most:
                    break
    return bytes(unpacked[:most])


class _Trickle(BytesIO):
    """Gives few bytes at a time: a library keeps to itself all that it made of a bad piece."""

    def read(self, size: int | None = -1) -> bytes:
        """Return the next bytes, fewer than asked for."""
        return super().read(min(size, _ZSTD_FEED) if size is not None and size > 0 else _ZSTD_FEED)

    read1 = read


class _Contexts(threading.local):
    """Decompression contexts: making one costs more than unpacking a small chunk with it."""

    @cached_property
    def lz4(self) -> Any:
        import lz4.frame

        return lz4.frame.create_decompression_context()

    @cached_property
    def zstd(self) -> Any:
        import zstandard

        return zstandard.ZstdDecompressor()


_contexts = _Contexts()


def _stored(data: Buffer, size: int) -> Buffer:  # noqa: ARG001  # the caller compares the sizes
    return data


def _unpack_lz4(data: Buffer, size: int) -> bytes:
    # lz4.frame.decompress makes a context for every call and believes the size in the frame.
    import lz4.frame

    lz4.frame.reset_decompression_context(_contexts.lz4)
    unpacked, consumed, ended = lz4.frame.decompress_chunk(_contexts.lz4, data, max_length=size)
    if consumed != len(data):
        raise _holds_more(size)
    if not ended:
        raise EOFError
    return bytes(unpacked)


def _unpack_zstd(data: Buffer, size: int) -> bytes:
    import zstandard

    in_frame = zstandard.frame_content_size(data)
    if in_frame not in {-1, size}:  # -1: the frame does not say
        raise CompressionError(f"it declares {size} bytes unpacked and holds {in_frame}")
    if size == 0:
        return b""
    return bytes(_contexts.zstd.decompress(data, max_output_size=size))


def _unpack_bz2(data: Buffer, size: int) -> bytes:
    import bz2

    stream = bz2.BZ2Decompressor()
    unpacked = stream.decompress(data, max_length=size)
    if not stream.eof and stream.decompress(b"", max_length=1):
        raise _holds_more(size)
    if not stream.eof:
        raise EOFError
    return unpacked


def _holds_more(size: int) -> CompressionError:
    return CompressionError(f"it declares {size} bytes unpacked and holds more")


_UNPACK: dict[str, Callable[[Buffer, int], Buffer]] = {
    "": _stored,
    "none": _stored,
    "lz4": _unpack_lz4,
    "zstd": _unpack_zstd,
    "bz2": _unpack_bz2,
}


def damage_of(compression: str) -> tuple[type[Exception], ...]:
    """Return what the library of a compression raises for damaged data."""
    if compression == "zstd":
        import zstandard

        return (zstandard.ZstdError, EOFError)
    # lz4 raises RuntimeError; bz2 and gzip OSError, EOFError or zlib.error.
    return (RuntimeError, OSError, EOFError, ValueError, zlib.error)


def pieces(file: BinaryIO, compression: str) -> Iterator[bytes]:
    """Yield the unpacked content of `file` in pieces of bounded size."""
    return _zstd_pieces(file) if compression == "zstd" else _file_pieces(file, compression)


def _file_pieces(file: BinaryIO, compression: str) -> Iterator[bytes]:
    stream: Any
    if compression == "lz4":
        import lz4.frame

        stream = lz4.frame.LZ4FrameFile(file, mode="rb")
    elif compression == "bz2":
        import bz2

        stream = bz2.BZ2File(file)
    else:
        import gzip

        stream = gzip.GzipFile(fileobj=file)
    with stream:
        while piece := stream.read1(_PIECE):
            yield piece


def _zstd_pieces(file: BinaryIO) -> Iterator[bytes]:
    # zstandard's own file reader takes a truncated file for a complete one.
    frame = None
    while packed := file.read(_ZSTD_FEED):
        while packed:
            frame = frame or _contexts.zstd.decompressobj()
            if piece := frame.decompress(packed):
                yield piece
            packed = frame.unused_data
            if frame.eof:
                frame = None
    if frame is not None:
        raise EOFError
