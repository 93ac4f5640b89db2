"""Compressed files, decompressed into a temporary copy."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.stores.compression import UnreadableDataError, decompressed_pieces
from quatprop.stores.limits import decompressed_limit, too_large
from quatprop.stores.temp_files import temp_folder

if TYPE_CHECKING:
    from collections.abc import Iterator

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
