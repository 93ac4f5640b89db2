"""Files that can be read at some places only, as those of a worn memory card."""

import errno

from quatprop.stores.file_source import FileSource


def wear(monkeypatch, starts=None, *, sector=range(0)):
    """Let reads fail that begin at some places, anywhere by default, or that touch a sector."""
    original = FileSource.read

    def read(source, start, length):
        touches = start < sector.stop and sector.start < start + length
        if touches if sector else starts is None or start in starts:
            raise OSError(errno.EIO, "Input/output error")
        return original(source, start, length)

    monkeypatch.setattr(FileSource, "read", read)
