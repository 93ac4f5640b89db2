"""Files that can be read at some places only, as those of a worn memory card."""

import errno

from quatprop.stores.file_source import FileSource


def wear(monkeypatch, is_worn=lambda _start: True):
    """Let reads fail that begin at some places, given as places or by a function."""
    is_worn = is_worn if callable(is_worn) else is_worn.__contains__
    original = FileSource.read

    def read(source, start, length):
        if is_worn(start):
            raise OSError(errno.EIO, "Input/output error")
        return original(source, start, length)

    monkeypatch.setattr(FileSource, "read", read)
