"""CRC-32, the checksum of MCAP; on most processors ten times as fast as that of zlib."""

from __future__ import annotations

try:
    from isal.isal_zlib import crc32
except ImportError:  # not available for some processors
    from zlib import crc32

__all__ = ["crc32"]
