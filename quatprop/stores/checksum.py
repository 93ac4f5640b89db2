"""The checksum of MCAP: CRC-32, ten times as fast as zlib's where the processor can help."""

from __future__ import annotations

try:
    from isal.isal_zlib import crc32
except ImportError:  # on processors that it is not made for
    from zlib import crc32

__all__ = ["crc32"]
