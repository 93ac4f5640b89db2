"""Files packed as a whole, unpacked into a temporary copy."""

from __future__ import annotations

import os
import tempfile
import weakref
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.containers.compression import CompressionError, damage_of, pieces
from quatprop.containers.limits import too_large, unpacked_limit

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

_MAGIC = {
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\x04\x22\x4d\x18": "lz4",
    b"BZh": "bz2",
    b"\x1f\x8b": "gz",
}


def file_compression(head: bytes) -> str:
    """Return how a file is packed from its first 4 bytes.

    Returns
    -------
    str
        ``"zstd"``, ``"lz4"``, ``"bz2"``, ``"gz"``, or ``""`` where it is not packed.
    """
    return next((name for magic, name in _MAGIC.items() if head.startswith(magic)), "")


class UnpackedCopy:
    """A file packed as a whole, unpacked into a temporary file that is always removed.

    Parameters
    ----------
    path
        A file packed with zstd, lz4, bz2 or gzip.

    Attributes
    ----------
    path
        The temporary file, with the suffix of the log inside. Where the packed file is damaged,
        it holds what comes before the damage.
    damage
        Why the copy ends early, or ``""``.

    Raises
    ------
    CompressionError
        The file is not packed, nothing of it can be unpacked, or the copy does not fit.
    OSError
        The file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.damage = ""
        with path.open("rb") as packed:
            compression = file_compression(packed.read(4))
            if not compression:
                raise CompressionError("it is not packed with zstd, lz4, bz2 or gzip")
            packed.seek(0)
            handle, name = tempfile.mkstemp(prefix="quatprop-", suffix=Path(path.stem).suffix)
            os.close(handle)
            self.path = Path(name)
            # Also runs when the interpreter ends, whatever the caller forgot.
            self._remove = weakref.finalize(self, self.path.unlink, missing_ok=True)
            limit = unpacked_limit(path.stat().st_size)
            try:
                self._fill(pieces(packed, compression), compression, limit)
            except BaseException:
                self.close()
                raise

    def _fill(self, pieces: Iterator[bytes], compression: str, limit: int) -> None:
        """Write the pieces up to the end or the damage."""
        with self.path.open("wb") as copy:
            while True:
                try:
                    piece = next(pieces, b"")
                except damage_of(compression) as error:
                    if copy.tell() == 0:
                        raise CompressionError(f"its {compression} data is damaged") from error
                    self.damage = f"its {compression} data is damaged or cut off"
                    return
                if not piece:
                    return
                if copy.tell() + len(piece) > limit:
                    raise CompressionError(too_large(limit))
                try:
                    copy.write(piece)
                    copy.flush()
                except OSError as error:
                    raise CompressionError(
                        f"its unpacked copy does not fit into {self.path.parent} "
                        f"({error.strerror}); set TMPDIR to a folder with room"
                    ) from error

    def close(self) -> None:
        """Remove the temporary file."""
        self._remove()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
