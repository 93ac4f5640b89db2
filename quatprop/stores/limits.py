"""Limits for damaged and hostile logs, and environment variables that change them.

The variables are for rare valid logs that exceed the limits; there are no parameters for them.
"""

from __future__ import annotations

import os
import re

from quatprop.errors import UsageError
from quatprop.stores.compression import UnreadableDataError
from quatprop.text import quoted

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
