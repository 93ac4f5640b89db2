"""Memory for decompressed chunks that is used again once nobody refers to it any more.

Chunks that follow one another lie in one buffer, so that their messages can be decoded together.
Fresh memory for each would cost as much as decompressing it: the system clears every page.
"""

from __future__ import annotations

import weakref
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bytes = NDArray[np.uint8]

BUFFER = 1 << 21
"""Bytes in a buffer: the chunks in it stay in the processor's cache until they are decoded."""

FIRST = 1 << 19
"""Bytes in the first buffer, for who reads only the beginning; each is twice as large as the one
before, up to :data:`BUFFER`."""


class Buffers:
    """Buffers in which pieces of memory are handed out, one after another."""

    def __init__(self) -> None:
        self._free: deque[memoryview] = deque()
        self._current = np.empty(0, np.uint8)
        self._used = 0
        self._size = FIRST

    def take(self, size: int) -> Bytes:
        """Return uninitialised memory of so many bytes; its base is the whole buffer.

        The memory is used again when no array refers to its buffer.
        """
        if self._used + size > len(self._current):
            self._current = np.empty(0, np.uint8)  # it may be free now
            self._current, self._used = self._buffer(max(size, self._size)), 0
            self._size = min(BUFFER, 2 * self._size)
        begin, self._used = self._used, self._used + size
        return self._current[begin : self._used]

    def _buffer(self, size: int) -> Bytes:
        memory = np.empty(0, np.uint8).data
        while self._free and len(memory) < size:
            memory = self._free.popleft()
        if not size <= len(memory) <= max(2 * size, BUFFER):
            # Not cleared, as a bytearray would be: pages that are not used cost nothing.
            memory = np.empty(size, np.uint8).data
        buffer = np.frombuffer(memory, np.uint8)
        weakref.finalize(buffer, self._free.append, memory).atexit = False
        return buffer


def place_in_buffer(data: Bytes) -> tuple[Bytes, int]:
    """Return the buffer that an array is a part of, and where in it the array begins.

    Where it is no part of a buffer, that is the array itself.

    Examples
    --------
    >>> memory = Buffers()
    >>> one, other = (np.frombuffer(memory.take(size).data, np.uint8) for size in (10, 5))
    >>> place_in_buffer(other)[0] is place_in_buffer(one)[0], place_in_buffer(other)[1]
    (True, 10)
    """
    part: object = data.base
    if isinstance(part, memoryview):
        part = part.obj
    buffer = getattr(part, "base", None) if isinstance(part, np.ndarray) else None
    if not isinstance(buffer, np.ndarray):
        return data, 0
    return buffer, _address(data) - _address(buffer)


def _address(data: Bytes) -> int:
    address: int = data.__array_interface__["data"][0]
    return address
