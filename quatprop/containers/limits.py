"""What users may set about damaged and hostile logs, by environment variables.

They are for the rare log that is right although it looks wrong, so they are no options of the
commands.
"""

from __future__ import annotations

import os
import re

from quatprop.containers.compression import CompressionError
from quatprop.errors import UsageError
from quatprop.text import quoted

CHECKSUMS = "QUATPROP_CHECKSUMS"
"""``ignore``: chunks whose checksum is wrong are read all the same."""


MAX_UNPACKED = "QUATPROP_MAX_UNPACKED"
"""Bytes that a log may unpack to in all, such as ``64G``."""

_LEAST = 2 << 30
_TIMES = 200
_BYTES = re.compile(r"(\d{1,18})\s*([KMGT]?)I?B?", re.IGNORECASE)
_POWERS = {"": 0, "K": 10, "M": 20, "G": 30, "T": 40}


def checksums_matter() -> bool:
    """Return whether what has a wrong checksum is left out."""
    return os.environ.get(CHECKSUMS, "").strip().lower() != "ignore"


class UnpackBudget:
    """Counts what one reading of a log unpacks to, up to the limit.

    Parameters
    ----------
    packed
        Bytes of the file.
    """

    def __init__(self, packed: int) -> None:
        self._limit = unpacked_limit(packed)
        self._unpacked = 0

    def check(self) -> None:
        """Refuse to unpack more when more was unpacked than a log may have.

        Raises
        ------
        CompressionError
            The limit is exceeded.
        """
        if self._unpacked > self._limit:
            raise CompressionError(too_large(self._limit))

    def spend(self, size: int) -> None:
        """Count bytes that were unpacked."""
        self._unpacked += size


def unpacked_limit(packed: int) -> int:
    """Return how many bytes a log may unpack to.

    That is 2 GiB, or 200 times its size where that is more, unless the environment says another
    number: no recording is packed as well as a file that was made to fill a disk.

    Parameters
    ----------
    packed
        Bytes of the file.

    Raises
    ------
    UsageError
        What the environment says is no number of bytes.

    Examples
    --------
    >>> unpacked_limit(1000) == 2 << 30
    True
    """
    said = os.environ.get(MAX_UNPACKED, "").strip()
    if not said:
        return max(_LEAST, _TIMES * packed)
    number = _BYTES.fullmatch(said)
    if number is None:
        raise UsageError(f"{MAX_UNPACKED} is {quoted(said)}, which is no number of bytes like 64G")
    return int(number[1]) << _POWERS[number[2].upper()]


def too_large(limit: int) -> str:
    """Return what is said of a log that unpacks to more."""
    return f"it unpacks to more than {limit} bytes; if that is right, set {MAX_UNPACKED} to more"
