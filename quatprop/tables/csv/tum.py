"""Trajectories of the TUM RGB-D benchmark, whose columns are known without a header."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, BinaryIO

from quatprop.errors import UnsupportedLogError
from quatprop.tables.csv.log import CsvLog

if TYPE_CHECKING:
    from pathlib import Path

COLUMNS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")


class TumLog(CsvLog):
    """A trajectory of eight columns: time in seconds, position, quaternion.

    Parameters
    ----------
    source
        As for :class:`quatprop.tables.csv.log.CsvLog`.

    Raises
    ------
    UnreadableLogError
        The file cannot be read, or is empty.
    UnsupportedLogError
        It has other columns.
    """

    kind = "tum"

    def __init__(self, source: Path | BinaryIO) -> None:
        super().__init__(source)
        if self._layout.header:
            return
        if len(self._layout.names) != len(COLUMNS):
            raise UnsupportedLogError(
                self.path,
                f"it has {len(self._layout.names)} columns, and a TUM trajectory has 8: "
                f"{' '.join(COLUMNS)}",
            )
        self._layout = replace(self._layout, names=list(COLUMNS))
