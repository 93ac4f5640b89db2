"""Limits for damaged and hostile logs, and the environment variables that change them.

The variables are for the rare log that is right although it looks wrong, so there are no
parameters for them.
"""

from __future__ import annotations

import os
import re

from quatprop.errors import UsageError
from quatprop.stores.compression import UnreadableDataError
from quatprop.text import quoted

CHECKSUMS = "QUATPROP_CHECKSUMS"
"""``ignore`` to read chunks whose checksum is wrong."""

MAX_UNPACKED = "QUATPROP_MAX_UNPACKED"
"""Bytes that a log may decompress to in all, such as ``64G``."""

_LEAST = 2 << 30
_TIMES = 200
_BYTES = r"(?i)(\d{1,18})\s*([KMGT]?)I?B?"
_POWERS = {"": 0, "K": 10, "M": 20, "G": 30, "T": 40}


def checksums_matter() -> bool:
    """Return whether data with a wrong checksum is left out."""
    return os.environ.get(CHECKSUMS, "").strip().lower() != "ignore"


class DecompressionBudget:
    """Counts the bytes that one reading of a log decompresses to, up to the limit.

    `size`: bytes of the file
    """

    def __init__(self, size: int) -> None:
        self._limit = decompressed_limit(size)
        self._spent = 0

    def check(self) -> None:
        """Refuse to go on where more was decompressed than a log may have."""
        if self._spent > self._limit:
            raise UnreadableDataError(too_large(self._limit))

    def spend(self, size: int) -> None:
        """Count bytes that were decompressed."""
        self._spent += size


def decompressed_limit(size: int) -> int:
    """Return how many bytes a log may decompress to.

    That is 2 GiB, or 200 times its size if that is more, unless the environment variable says
    otherwise: no recording compresses as well as a file that was made to fill a disk.
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
    """Return the reason for refusing a log that decompresses to more."""
    return (
        f"it decompresses to more than {limit} bytes; if that is right, set {MAX_UNPACKED} to more"
    )
